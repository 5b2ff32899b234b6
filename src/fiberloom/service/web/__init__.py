"""The service over HTTP: routes, page, stream, server."""
