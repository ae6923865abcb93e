"""Settings as the command line takes them."""

from __future__ import annotations


def assigned(*texts: str) -> dict[str, str]:
    """The values of parameters by ``set.parameter``, from texts such as ``opplod.gain=2``."""
    return dict(text.split("=", 1) for text in texts)
