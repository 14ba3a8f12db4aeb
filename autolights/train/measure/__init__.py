"""How good a detector is: figures, curves, comparisons."""
