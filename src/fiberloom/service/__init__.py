"""The service: one array, its commands over HTTP, its motion as a stream, and a live page."""
