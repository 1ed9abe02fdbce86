"""Optimizers behind one ask/tell; each file stands alone and knows nothing of the simulator."""
