"""Photos of one pose to a scan: dense stereo and surface cleaning on arrays."""
