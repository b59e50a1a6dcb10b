"""Device interfaces: decoders of firmware that does not use the link's protocol."""
