"""Contact laws of scenes whose reference results use node-to-segment contact, elastic impact."""

from functools import partial
from typing import Any

import dolfinx_nts as nts

__all__ = ["NODAL", "NODAL_PAIR", "NODES"]

NODES: dict[str, Any] = {"method": "node-to-segment"}
NODAL: dict[str, Any] = {"enforcement": nts.LagrangeMultiplier()} | NODES
NODAL_PAIR = partial(nts.ContactPair, **NODAL)
