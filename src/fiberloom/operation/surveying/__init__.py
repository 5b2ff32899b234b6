"""What a survey of the focal plane keeps of its images."""
