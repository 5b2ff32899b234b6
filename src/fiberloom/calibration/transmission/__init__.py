"""Motor angle against output angle: sweeps, maps, their files."""
