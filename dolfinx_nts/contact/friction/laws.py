"""Laws of friction: the largest tangential force of a node, and its derivatives.

In all methods of contact a law gets the normal force p of a node [N], and limits the tangential
force of this node [N]. In mortar contact these are nodal multipliers, which are forces too.
Coulomb's law is therefore the same in all methods; a law with a stress multiplies it by the area of
the node.
"""

import weakref
from abc import abstractmethod
from collections.abc import Mapping
from numbers import Real
from typing import Any, Literal, TypeAlias

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arguments import as_call, kind_of, nonnegative, positive, with_article
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.common.declaration import Declaration
from dolfinx_nts.fem.node_numbering import reference_positions

__all__ = [
    *("SLIP_MEASURES", "Coefficient", "Coulomb", "FrictionLaw", "FrictionNodes"),
    *("SlipWeakening", "Stribeck", "Tresca", "friction_law"),
]

# A coefficient of friction: a number, a scalar Constant, or a scalar Function of the mesh, read at
# the nodes.
Coefficient: TypeAlias = float | fem.Constant | fem.Function

# Measures of slip, see `Coulomb`.
SLIP_MEASURES = ("objective", "convective")

# A cell at each local node of a space, by the id of the space.
_CELLS: dict[int, Ints] = {}


class FrictionNodes:
    """Nodes at which a law of friction is evaluated, ``m`` in number. Local.

    The argument ``nodes`` of `FrictionLaw.limit`, created by the package.

    Args:
        of_surface: Nodes of the contact pair, ``n`` in number.
        node: Indices of the nodes among these, shape ``(m,)``.
        area: Reference areas of the nodes of the pair, shape ``(n,)`` [m^2].
        slipped: Accumulated slip of the nodes of the pair at the start of the step, shape ``(n,)``
            [m].
        known: Values of Functions and Constants at the nodes of the pair that have been read.
        round_off: Size of negative values of Functions that count as zero; 0 for others.

    Example:
        >>> class Adhesive(nts.FrictionLaw):
        ...     def limit(self, p, slip, dt, nodes):
        ...         return 0.3 * p + 1.0e3 * nodes.area, 0.3, 0.0  # 1 kPa without pressure
        >>> Adhesive().describe()
        'friction by Adhesive()'
    """

    def __init__(
        self,
        of_surface: Any,
        node: Ints,
        area: Floats,
        slipped: Floats,
        known: dict[Any, Floats],
        round_off: Mapping[Any, float],
    ) -> None:
        self._of_surface, self._node, self._known = of_surface, node, known
        self._area, self._slipped, self._round_off = area, slipped, round_off

    @property
    def area(self) -> Floats:
        """Reference area on which each node transmits force, positive, shape ``(m,)`` [m^2].

        The pressure is the normal force divided by it. In the plane it is per metre of thickness
        [m]. With mortar contact it is the covered part, which changes from step to step. Vertices
        of triangles of degree 2, on which a uniform pressure has no force, have a thousandth of
        the mean share of their facets.
        """
        return self._area[self._node]

    @property
    def slipped(self) -> Floats:
        """Accumulated slip of each node at the start of the step, shape ``(m,)`` [m]."""
        return self._slipped[self._node]

    def value(self, coefficient: Coefficient) -> Any:
        """Value of a coefficient at each node: the number itself, or shape ``(m,)``.

        A Function or Constant is read once in each attempt at a step, a Function at the reference
        positions of the nodes. A discontinuous Function, such as one of degree 0, has the value of
        one of the adjacent cells. Of a Function that is an attribute of the law, negative values
        within 1e-12 of its largest absolute value are zeros with round-off, and are 0.

        Args:
            coefficient: A number of any sign, a scalar Constant, or a scalar Function, such as a
                temperature.

        Raises:
            TypeError: It is none of these, or not scalar.
            ValueError: The Function belongs to another mesh, or has values at quadrature points
                only.
        """
        if isinstance(coefficient, Real):
            return coefficient
        _check_field("the coefficient of a friction law", coefficient)
        if coefficient not in self._known:
            nodes = self._of_surface
            if isinstance(coefficient, fem.Constant):
                self._known[coefficient] = np.full(len(nodes.nodes), float(coefficient.value))
            else:
                values = _nodal_values(coefficient, nodes.V, nodes.nodes)
                is_zero = (values < 0) & (values >= -self._round_off.get(coefficient, 0.0))
                self._known[coefficient] = np.where(is_zero, 0.0, values)
        return self._known[coefficient][self._node]


class FrictionLaw(Declaration):
    """Base class of laws of friction. Local.

    A node sticks up to the limit of its tangential force. A node that slides has a tangential force
    of this size, opposite to its slip. A law is one method, `limit`. Objects are immutable: set
    attributes in ``__init__``.

    Attributes:
        eps_T: Stiffness of the tangential spring of a node [N/m], positive; None, the default, as
            in `Coulomb`.
        law: How slip is measured, ``"objective"`` or ``"convective"``, see `Coulomb`.
        depends_on_slip: Whether the limit depends on the slip of the step. True, the default, is
            always valid. False saves evaluations if the derivative with respect to the slip is zero
            everywhere.

    Example:
        >>> class Viscous(nts.FrictionLaw):
        ...     def limit(self, p, slip, dt, nodes):
        ...         mu = 0.2 + 0.1 * slip / dt
        ...         return mu * p, mu, 0.1 / dt * p
        >>> pair = nts.ContactPair(bottom, top, friction=Viscous())
        >>> print(pair)
        surface-to-surface contact by Penalty, friction by Viscous()
    """

    eps_T: float | None = None
    law: Literal["objective", "convective"] = "objective"
    depends_on_slip = True

    @abstractmethod
    def limit(
        self, p: Floats, slip: Floats, dt: float, nodes: FrictionNodes
    ) -> tuple[Floats, Floats, Floats]:
        """Evaluate the limit of the tangential force at ``m`` nodes, and its derivatives. Local.

        Args:
            p: Normal force of each node, shape ``(m,)`` [N, >= 0], in all methods of contact.
            slip: Length of the slip in the step, shape ``(m,)`` [m]; 0 at sticking nodes, for the
                limit of static friction.
            dt: Length of the step [s]. The mean speed of slip is ``slip / dt``.
            nodes: Areas, accumulated slip and values of Functions at the nodes.

        Returns:
            Limit, shape ``(m,)`` [N, >= 0], and its derivatives with respect to p [-] and to slip
            [N/m]. The derivatives may be numbers; the limit is an array.
        """

    @property
    def acts(self) -> bool:
        """Whether there is friction: False if the coefficient is 0."""
        return True

    def describe(self) -> str:
        """Text that describes the law, for ``str`` of a pair."""
        return f"friction by {self!r}"

    def __repr__(self) -> str:
        """Constructor call in one line. Local."""
        return as_call(self, **{name: _shown(value) for name, value in vars(self).items()})


class Coulomb(FrictionLaw):
    """Coulomb's law of friction: a node sticks up to mu times the normal force.

    Args:
        mu: Coefficient of friction [-]: a number, or a scalar Constant or Function of the mesh,
            evaluated at the nodes at the beginning of each step.
        eps_T: Stiffness of the tangential spring at a node [N/m], whose elastic slip is
            recoverable. None: no spring, so that a sticking node does not slip at all
            (multipliers). With normal contact by springs, None means a tangential spring that is
            stiffer than the cells in shear by as much as loaded normal springs in compression.
        law: How slip is measured. ``"objective"``: by an increment that is quadratic in the
            positions, so that dissipation is exact (``cpp/nts/contact/slip.h``). ``"convective"``:
            by the increment of the convective coordinates on the segment (Franke, Hesch, Betsch
            2011, eqs. 60-64); for comparison, only with `Midpoint`, `Penalty` and a deformable
            counterpart.

    Attributes:
        mu, eps_T, law: The arguments.

    Raises:
        TypeError: ``mu`` is not a number, Constant or Function, or not scalar.
        ValueError: ``mu`` is negative, ``eps_T`` not positive, or there is no such ``law``.

    Example:
        >>> print(nts.ContactPair(bottom, top, friction=nts.Coulomb(mu=0.3)))
        surface-to-surface contact by Penalty, Coulomb friction with mu = 0.3
    """

    depends_on_slip = False

    def __init__(
        self,
        mu: Coefficient,
        eps_T: float | None = None,
        law: Literal["objective", "convective"] = "objective",
    ) -> None:
        """Check the coefficient, the stiffness and the name of the law."""
        self.mu = _coefficient("a coefficient of friction mu", mu)
        if law not in SLIP_MEASURES:
            raise ValueError(f"expected law 'objective' or 'convective', given {law!r}")
        self.eps_T, self.law = _stiffness(eps_T), law

    def limit(
        self, p: Floats, slip: Floats, dt: float, nodes: FrictionNodes
    ) -> tuple[Floats, Floats, Floats]:
        mu = nodes.value(self.mu)
        return mu * p, mu, np.zeros(1)

    @property
    def acts(self) -> bool:
        return not (isinstance(self.mu, Real) and self.mu == 0)

    def describe(self) -> str:
        return f"Coulomb friction with mu = {_words(self.mu)}"


class Stribeck(FrictionLaw):
    r"""Friction that depends on the speed of slip v, by a regularised Stribeck curve.

    .. math:: \mu(v) = \mu_k + (\mu_s - \mu_k) \exp(-(v/v_s)^\delta) + c v

    With ``power=1`` and ``viscous=0`` these are static and kinetic coefficients with an exponential
    decay. If the limit decreases so fast that stick and slip are both solutions of a step, a node
    that slid continues to slide.

    Args:
        static: Static coefficient mu_s [-], a number, Constant or Function, see `Coulomb`.
        kinetic: Kinetic coefficient mu_k [-], a number, Constant or Function, see `Coulomb`.
        speed: Speed v_s over which the coefficient falls from one to the other [m/s]; 0: static
            where a node sticks, kinetic where it slides.
        viscous: Slope c of the coefficient at high speeds [s/m].
        power: Exponent delta [-], at least 1.
        eps_T: See `Coulomb`.

    Attributes:
        static, kinetic, speed, viscous, power, eps_T: The arguments.

    Raises:
        TypeError: A coefficient is not a number, Constant or Function, or not scalar.
        ValueError: A number is negative, ``eps_T`` not positive, ``power`` below 1.

    Example:
        >>> brake = nts.Stribeck(static=0.4, kinetic=0.3, speed=0.1)
        >>> print(nts.ContactPair(bottom, top, friction=brake).friction.describe())
        Stribeck friction, mu from 0.4 to 0.3
    """

    def __init__(
        self,
        static: Coefficient,
        kinetic: Coefficient,
        speed: float,
        viscous: float = 0.0,
        power: float = 1.0,
        eps_T: float | None = None,
    ) -> None:
        """Check the arguments."""
        self.static = _coefficient("a static coefficient of friction", static)
        self.kinetic = _coefficient("a kinetic coefficient of friction", kinetic)
        self.speed = nonnegative("a speed of the decay of friction", speed)
        self.viscous = nonnegative("a slope of viscous friction", viscous)
        if not power >= 1:
            raise ValueError(f"expected an exponent power >= 1 of the decay, given {power}")
        self.power, self.eps_T = float(power), _stiffness(eps_T)

    def limit(
        self, p: Floats, slip: Floats, dt: float, nodes: FrictionNodes
    ) -> tuple[Floats, Floats, Floats]:
        static, kinetic = nodes.value(self.static), nodes.value(self.kinetic)
        if self.speed == 0:
            falls, slope = (static - kinetic) * (slip == 0), np.zeros(1)
        else:
            ratio = slip / (dt * self.speed)
            falls = (static - kinetic) * np.exp(-(ratio**self.power))
            slope = -falls * (self.power / self.speed) * ratio ** (self.power - 1)
        mu = kinetic + falls + self.viscous * slip / dt
        return mu * p, mu, (slope + self.viscous) / dt * p

    def describe(self) -> str:
        return f"Stribeck friction, mu from {_words(self.static)} to {_words(self.kinetic)}"


class SlipWeakening(FrictionLaw):
    r"""Static and kinetic coefficients of friction, with a decay length.

    .. math:: \mu(s) = \mu_k + (\mu_s - \mu_k) \exp(-s/L)

    s is the accumulated slip of a node, as in ``ContactPair.history.slip``. It never decreases.

    Args:
        static: Static coefficient mu_s [-], a number, Constant or Function, see `Coulomb`.
        kinetic: Kinetic coefficient mu_k [-], a number, Constant or Function, see `Coulomb`.
        length: Decay length L [m].
        eps_T: See `Coulomb`.

    Attributes:
        static, kinetic, length, eps_T: The arguments.

    Raises:
        TypeError: A coefficient is not a number, Constant or Function, or not scalar.
        ValueError: A number is negative, ``length`` or ``eps_T`` not positive.

    Example:
        >>> fault = nts.SlipWeakening(static=0.6, kinetic=0.5, length=0.01)
        >>> print(nts.ContactPair(bottom, top, friction=fault).friction.describe())
        slip-weakening friction, mu from 0.6 to 0.5
    """

    def __init__(
        self,
        static: Coefficient,
        kinetic: Coefficient,
        length: float,
        eps_T: float | None = None,
    ) -> None:
        """Check the arguments."""
        self.static = _coefficient("a static coefficient of friction", static)
        self.kinetic = _coefficient("a kinetic coefficient of friction", kinetic)
        self.length = positive("a length of the decay of friction", length)
        self.eps_T = _stiffness(eps_T)

    def limit(
        self, p: Floats, slip: Floats, dt: float, nodes: FrictionNodes
    ) -> tuple[Floats, Floats, Floats]:
        static, kinetic = nodes.value(self.static), nodes.value(self.kinetic)
        falls = (static - kinetic) * np.exp(-(nodes.slipped + slip) / self.length)
        mu = kinetic + falls
        return mu * p, mu, -falls / self.length * p

    def describe(self) -> str:
        return f"slip-weakening friction, mu from {_words(self.static)} to {_words(self.kinetic)}"


class Tresca(FrictionLaw):
    """A law of friction with an upper bound on the shear stress, such as the yield stress in shear.

    Args:
        law: The law of friction that is limited; a number is the coefficient of `Coulomb`.
        stress: Largest tangential force per reference area [Pa], a number, Constant or Function.
            The area is that of the facets around a node that face the segments, or in mortar
            contact the area that segments cover.

    Attributes:
        stress: The argument.

    Raises:
        TypeError: An argument has the wrong type.
        ValueError: The stress is negative.

    Example:
        >>> forging = nts.Tresca(nts.Coulomb(mu=0.3), stress=50.0e6)
        >>> print(nts.ContactPair(bottom, top, friction=forging).friction.describe())
        Coulomb friction with mu = 0.3, up to 5e+07 Pa
    """

    def __init__(self, law: FrictionLaw | float, stress: Coefficient) -> None:
        """Check the arguments."""
        self._law_below = friction_law(law)
        self.stress = _coefficient("a shear stress", stress)

    @property
    def eps_T(self) -> float | None:  # type: ignore[override]
        """Stiffness of the tangential springs of the law that is limited [N/m]."""
        return self._law_below.eps_T

    @property
    def depends_on_slip(self) -> bool:  # type: ignore[override]
        """Whether the law that is limited depends on slip."""
        return self._law_below.depends_on_slip

    def limit(
        self, p: Floats, slip: Floats, dt: float, nodes: FrictionNodes
    ) -> tuple[Floats, Floats, Floats]:
        force, by_p, by_slip = self._law_below.limit(p, slip, dt, nodes)
        cap = nodes.value(self.stress) * nodes.area
        below = force <= cap
        return np.minimum(force, cap), np.where(below, by_p, 0.0), np.where(below, by_slip, 0.0)

    @property
    def acts(self) -> bool:
        return self._law_below.acts

    def describe(self) -> str:
        return f"{self._law_below.describe()}, up to {_words(self.stress)} Pa"

    def __repr__(self) -> str:
        return as_call(self, law=self._law_below, stress=_shown(self.stress))


def friction_law(law: FrictionLaw | float) -> FrictionLaw:
    """Return a law as it is, and Coulomb's law for a number. Local.

    Raises:
        TypeError: It is neither.
    """
    if isinstance(law, Real) and not isinstance(law, bool):
        return Coulomb(float(law))
    if not isinstance(law, FrictionLaw):
        raise TypeError(f"expected Coulomb(mu) or another law as friction, given {kind_of(law)}")
    return law


def _nodal_values(function: fem.Function, V: fem.FunctionSpace, nodes: Ints) -> Floats:
    """Values of a scalar Function at owned nodes of a space, shape ``(n,)``. Local."""
    if function.function_space.mesh != V.mesh:
        raise ValueError(
            "expected a Function of the mesh of the contact pair, given one of another mesh"
        )
    if not len(nodes):
        return np.zeros(0)
    if id(V) not in _CELLS:
        weakref.finalize(V, _CELLS.pop, id(V))
        dofs = V.dofmap.list
        _CELLS[id(V)] = cell = np.zeros(dofs.max() + 1, dtype=np.int32)
        cell[dofs] = np.arange(len(dofs), dtype=np.int32)[:, None]
    values: Floats = function.eval(reference_positions(V)[nodes], _CELLS[id(V)][nodes])
    return values.reshape(len(nodes))


def _coefficient(name: str, value: Coefficient) -> Coefficient:
    """Check a coefficient: a number >= 0, a scalar Constant or a scalar Function."""
    if isinstance(value, Real):
        return nonnegative(name, value)
    _check_field(name, value)
    return value


def _check_field(name: str, value: Any) -> None:
    """Check that a coefficient other than a number has a value at each node."""
    if not isinstance(value, fem.Constant | fem.Function):
        raise TypeError(
            f"expected {name} as a number, a fem.Constant or a fem.Function, given "
            f"{kind_of(value)}: interpolate an expression into a Function"
        )
    if value.ufl_shape:
        raise TypeError(
            f"expected {name} as a scalar {type(value).__name__}, given shape {value.ufl_shape}"
        )
    if isinstance(value, fem.Function):
        element = value.function_space.ufl_element()
        if element.family_name == "quadrature":
            raise ValueError(
                f"expected {name} as a Function with a value at each node, given one with values "
                'at quadrature points: interpolate it into ("Discontinuous Lagrange", 0)'
            )


def _stiffness(eps_T: float | None) -> float | None:
    return None if eps_T is None else positive("a tangential stiffness eps_T", eps_T)


def _shown(value: Any) -> Any:
    """Value in a ``repr``; only the class of a Constant, whose own repr contains the mesh."""
    return type(value) if isinstance(value, fem.Constant) else value


def _words(coefficient: Coefficient) -> str:
    if isinstance(coefficient, Real):
        return f"{coefficient:g}"
    return with_article(type(coefficient).__name__)
