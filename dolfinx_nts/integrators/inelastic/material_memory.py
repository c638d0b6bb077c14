"""Interface of the internal variables of a material, at its quadrature points."""

from abc import ABC, abstractmethod
from typing import Any

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats, Ints

__all__ = ["MaterialMemory"]


class MaterialMemory(ABC):
    """Base class of the internal variables of one material at its quadrature points.

    ``parameters`` are the material parameters by name, as constants. UFL results are per reference
    volume.
    """

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
        """Virtual work with a test function eta, UFL [J/m^3]."""

    @abstractmethod
    def elastic_work(self, parameters: Any, eta: Any) -> Any:
        """Virtual work with the state frozen at the end of the accepted step, UFL [J/m^3]."""

    @abstractmethod
    def stiffness(self, parameters: Any, rate: Any) -> Any:
        """Stress increment of the tangent for a Green strain increment, UFL (3, 3) [Pa]."""

    @abstractmethod
    def dissipation(self, parameters: Any) -> Any:
        """Energy dissipated in the accepted step, UFL [J/m^3]."""

    @abstractmethod
    def energy(self, parameters: Any) -> Any:
        """Energy at the end of the accepted step, UFL [J/m^3]."""

    @abstractmethod
    def energy_at_start(self, parameters: Any) -> Any:
        """Energy at the start of the accepted step, UFL [J/m^3]."""

    @abstractmethod
    def stress(self, parameters: Any, C: Any) -> tuple[Any, Any]:
        """Stress and energy at t, with one set of internal variables for each cell.

        Args:
            parameters: Material parameters.
            C: Right Cauchy-Green tensor at t, UFL (3, 3).

        Returns:
            Second Piola-Kirchhoff stress, UFL (3, 3) [Pa], and energy, UFL [J/m^3].
        """
