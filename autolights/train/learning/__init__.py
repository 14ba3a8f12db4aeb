"""What the network is told by a batch: assignment, loss, rates, steps."""
