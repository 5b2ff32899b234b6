"""The documentation as a site: equations, the page of the commands, the tutorial's answers."""
