"""Many recordings with many configurations, each tracked once, and which did best."""
