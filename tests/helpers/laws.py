"""Laws of scenes whose results belong to nodal contact with elastic impact."""

from typing import Any

import dolfinx_nts as nts

__all__ = ["NODAL", "NODES"]

NODES: dict[str, Any] = {"method": "node-to-segment"}
NODAL: dict[str, Any] = {"enforcement": nts.LagrangeMultiplier()} | NODES
