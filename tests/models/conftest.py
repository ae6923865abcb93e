from __future__ import annotations

from tests.arithmetic import each_arithmetic

__all__ = ["each_arithmetic"]  # for every test here
