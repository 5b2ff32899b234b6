"""The telescope of an instrument: sites, wavelengths of the fibres, optics."""
