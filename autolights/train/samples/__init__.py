"""Labelled images on their way to the network: cached, placed, changed, put into batches."""
