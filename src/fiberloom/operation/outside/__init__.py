"""Arrays outside of this process by the protocol of their motors."""
