"""``oppload evaluate``: detectors and plain baselines over labelled clips."""
