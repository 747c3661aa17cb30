"""Draw lists to the surface buffer."""
