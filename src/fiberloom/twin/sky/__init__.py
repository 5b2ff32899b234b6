"""The twin's sky: stars over the fibres, seen through an atmosphere by a telescope that is guided."""
