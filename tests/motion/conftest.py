from __future__ import annotations

from tests.arithmetic import each_arithmetic  # noqa: F401 - for every test here
