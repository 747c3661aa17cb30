"""Pictures, videos and a window: the loop around everything above."""
