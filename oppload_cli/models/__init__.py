"""The layers and models: functions of arrays that return values (``docs/model.md``)."""

LOAD = "OPPLOAD_LOAD"  # environment variable: a user's detectors to load, separated as in PATH
EXAMPLE_SETTING = "opplod.gain=2"  # for help texts and messages
