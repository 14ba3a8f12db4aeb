"""The detector network: layers, checkpoints, and what it costs."""
