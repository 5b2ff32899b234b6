"""By how much arms turn under gravity: a model, images that tell it, and how fibres are led by it."""
