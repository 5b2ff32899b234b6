"""Moving whole focal planes: blind move, camera, corrections, decisions."""
