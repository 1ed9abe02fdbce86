"""Optimizers with an ask/tell interface. They do not depend on the simulator."""
