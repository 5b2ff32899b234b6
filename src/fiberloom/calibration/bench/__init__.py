"""One unit on a bench: friction, stiffness, inertia, arms, repeatability, acceptance."""
