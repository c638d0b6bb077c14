"""Settings to compare: a contact method and a contact law each."""

from typing import NamedTuple

import dolfinx_nts as nts

__all__ = ["BASE", "METHODS", "SETTINGS", "Setting"]

METHODS = ("node-to-segment", "mortar")
# Stiffness of springs relative to the static stiffness of their nodes [-].
FACTORS = (1, 2, 4, 16)


class Setting(NamedTuple):
    """A contact method and a contact law.

    Attributes:
        method: Of `nts.ContactPair`; None for the default.
        law: Kind of impact of `nts.LagrangeMultiplier`, "" for springs, or None for the default.
        factor: Stiffness of springs relative to the default of `nts.Penalty` [-].
    """

    method: str | None
    law: str | None
    factor: float = 1.0

    @property
    def enforcement(self) -> nts.LagrangeMultiplier | nts.Penalty | None:
        """Law of normal contact."""
        if self.law is None:
            return None
        if self.law:
            return nts.LagrangeMultiplier(self.law)
        springs = nts.Penalty()
        vars(springs)["share"] = self.factor  # as `Penalty.halved` does, before it is in use
        return springs

    def method_for(self, segments: nts.Surface | nts.Obstacle, nodes: nts.Surface) -> str | None:
        """Method for a pair: node-to-segment where surface-to-surface contact does not exist."""
        if self.method is None:
            return None
        meshed = isinstance(segments, nts.Surface) and segments is not nodes
        return self.method if meshed else METHODS[0]

    def pair(
        self,
        nodes: nts.Surface,
        segments: nts.Surface | nts.Obstacle,
        friction: nts.Coulomb | None = None,
    ) -> nts.ContactPair:
        """Contact pair of two surfaces, or of a surface and an obstacle."""
        method = self.method_for(segments, nodes)
        return nts.ContactPair(nodes, segments, self.enforcement, friction, method)


_LAWS = {law: Setting("", law) for law in ("elastic", "plastic", "resolved")}
_LAWS |= {f"springs x {factor:g}": Setting("", "", factor) for factor in FACTORS}
SETTINGS = {"default": Setting(None, None)}
SETTINGS |= {
    f"{law}, {method}": setting._replace(method=method)
    for method in METHODS
    for law, setting in _LAWS.items()
}
# Whose costs are 1.
BASE = "elastic, node-to-segment"
