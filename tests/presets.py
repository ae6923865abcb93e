"""The parameters of OppLoD, and of the places, under the presets."""

from __future__ import annotations

from oppload_cli.detection.contact import place_params
from oppload_cli.models.opplod_parameters import OpplodParams
from oppload_cli.models.registry import parameters_of

DEFAULT = OpplodParams()
REFERENCE = parameters_of("opplod", "reference")
LPLC2 = parameters_of("opplod", "lplc2")
PLACES = place_params("reference")  # of the objects that REFERENCE shows
PAPER = parameters_of("opplod", "paper")
