"""Every detector on one battery of stimuli: selectivity, invariance and cost."""
