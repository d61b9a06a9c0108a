"""Images of warped events, their contrast, and pictures of both, in NumPy."""
