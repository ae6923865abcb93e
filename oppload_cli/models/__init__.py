"""The layers and models: arrays in, values out (``docs/model.md``)."""

LOAD = "OPPLOAD_LOAD"  # in the environment: own detectors to load, separated as in PATH
