"""What the points of one material remember, and what that adds to forms."""

from abc import ABC, abstractmethod
from typing import Any

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats, Ints

__all__ = ["MaterialMemory"]


class MaterialMemory(ABC):
    """Base of the states of materials. Parameters are their numbers by name, as constants."""

    @abstractmethod
    def begin(self) -> None:
        """Begin a step with the state that was accepted last. Local."""

    @abstractmethod
    def accept(self) -> None:
        """Set the state at the end of the step that was solved. Local."""

    @abstractmethod
    def serialize(self, archive: Archive, name: str) -> None:
        """Serialize the state at both ends of the last step."""

    @abstractmethod
    def plastic_strain(self) -> tuple[Ints, Floats]:
        """Owned cells, and their mean equivalent plastic strain, both ``(c,)`` [-]. Local."""

    @abstractmethod
    def work(self, parameters: Any, eta: Any) -> Any:
        """Virtual work per reference volume with a test function, UFL [J/m^3]."""

    @abstractmethod
    def elastic_work(self, parameters: Any, eta: Any) -> Any:
        """The same of a step in which the points keep the state at the end of the accepted one."""

    @abstractmethod
    def stiffness(self, parameters: Any, rate: Any) -> Any:
        """Stress of a strain E at the end of the step, as a tangent has it, UFL (3, 3) [Pa]."""

    @abstractmethod
    def dissipation(self, parameters: Any) -> Any:
        """Energy that is lost in the accepted step, per reference volume, UFL [J/m^3]."""

    @abstractmethod
    def energy(self, parameters: Any) -> Any:
        """Energy at the end of the accepted step per reference volume, UFL [J/m^3]."""

    @abstractmethod
    def energy_at_start(self, parameters: Any) -> Any:
        """The same at the start of the step."""

    @abstractmethod
    def stress(self, parameters: Any, C: Any) -> tuple[Any, Any]:
        """Stress and energy at t with one state for each cell.

        Args:
            parameters: Numbers of the material.
            C: Right Cauchy-Green tensor at t, UFL (3, 3).

        Returns:
            Second Piola-Kirchhoff stress, UFL (3, 3) [Pa], and energy, UFL [J/m^3].
        """
