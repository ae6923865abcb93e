"""The layers and models: arrays in, values out (``docs/model.md``)."""
