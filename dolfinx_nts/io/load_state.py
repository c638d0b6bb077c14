"""Start of a scene from the checkpoint of another one on the same mesh."""

import logging
import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arguments import kind_of
from dolfinx_nts.contact.history import without_friction
from dolfinx_nts.diagnostics.names import pair_names
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.integrators.statics.quasi_static import QuasiStatic
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.io.checkpoint import Reader
from dolfinx_nts.io.checkpoint_file import CheckpointFile
from dolfinx_nts.io.fingerprint import fingerprint
from dolfinx_nts.parallel import reductions

__all__ = ["load_state"]

_logger = logging.getLogger("dolfinx_nts")

# Parameters of laws that may change without invalidating the state of contact.
_MAY_CHANGE = re.compile(r"(?<=impact=)\w+|(?<=mu=)[^,)]+")


class _Kept(NamedTuple):
    """Source of the contact state of a pair: its number in the checkpoint; whether slip is kept."""

    number: int
    friction: bool


class _Other(NamedTuple):
    """Pair of the checkpoint with the same sides and other laws: its number, and the difference."""

    number: int
    text: str


def load_state(path: str | Path, stepper: Stepper) -> tuple[str, ...]:
    """Start a stepper from the checkpoint of another scene. Collective.

    Only the mesh and the degree must be the same. Loads, supports, materials, laws, pairs, the
    integrator and the number of ranks may differ. Time, step number, displacements and velocities
    are copied; the stepper keeps its step ``dt``. A pair with the same two sides and method as a
    pair in the checkpoint gets its contact state, also with another kind of impact or coefficient
    of friction; springs must have the same stiffness. Defaults differ: multipliers in statics,
    springs in dynamics. Data that are not used are returned and logged. `Recorder` writes
    checkpoints with ``checkpoint_every``; to continue the same scene exactly, use its ``resume``.

    Args:
        path: The checkpoint.
        stepper: Stepper of the new scene.

    Returns:
        Descriptions of the data in the checkpoint that are not used.

    Raises:
        TypeError: The path is neither a str nor a Path, or the stepper not a Stepper.
        ValueError: There is no file, or it is not a checkpoint, is damaged, or belongs to another
            mesh. Nothing has been changed.

    Example:
        >>> with nts.Recorder("press", stepper, checkpoint_every=50) as record:
        ...     for step in stepper.run(until=0.02):
        ...         record.write(step)
        >>> law = nts.LagrangeMultiplier()  # that of `stepper`, as is the method
        >>> rough = nts.ContactPair(bottom, top, law, nts.Coulomb(mu=0.3), "node-to-segment")
        >>> other_stepper = nts.EnergyMomentum(bodies, [rough], dt=0.005)
        >>> nts.load_state("press.checkpoint.h5", other_stepper)
        ('state of the linear solver',)
        >>> other_stepper.t
        0.02
    """
    if not (isinstance(path, str | Path) and isinstance(stepper, Stepper)):
        raise TypeError(
            "expected load_state(path, stepper), the name of a checkpoint and the stepper that "
            f"starts from it, given {kind_of(path)} and {kind_of(stepper)}"
        )
    path, comm = Path(path), stepper.u.function_space.mesh.comm
    now = fingerprint(stepper)
    with CheckpointFile(comm, path) as file:
        scene = file.scene
        if scene["mesh"] != now["mesh"]:
            raise ValueError(
                f"expected a checkpoint of this mesh, nodes and cells, given {path}, in which it "
                f"is {scene['mesh']} instead of {now['mesh']}"
            )
        kept, others = _pairs_with_state(scene, now)
        contacts = {i: f"pair_{k.number}" for i, k in kept.items()}
        same_scheme = scene["integrator"] == now["integrator"]
        same_bodies = _bodies(scene) == _bodies(now)
        stepper.copy_state(
            Reader(stepper, file), contacts, same_scheme=same_scheme, same_bodies=same_bodies
        )
    dropped = ["state of the linear solver", *_without_motion(stepper, comm)]
    if stepper.memory.exists and not same_bodies:
        dropped.append(
            "internal variables of materials: dashpots and plastic flow begin without strain"
        )
    names, begun = pair_names(stepper.pairs), list[str]()
    for i, name in enumerate(names):
        if i in others:
            text = f"contact of {name}: {others[i].text}"
            dropped.append(text)
            if comm.rank == 0:
                _logger.warning("%s: %s", path, text)
        elif i not in kept:
            begun.append(name)
            dropped.append(f"contact of {name}, which begins without history")
        elif not kept[i].friction:
            contact = stepper.contacts[i]
            contact.accept(without_friction(contact.history))
            dropped.append(f"friction of {name}, which begins without history")
    used = {k.number for k in kept.values()} | {other.number for other in others.values()}
    unused = [n for n in _pairs(scene) if n not in used]
    dropped += [f"contact of pair {n} of the checkpoint, which this scene lacks" for n in unused]
    if begun and unused and comm.rank == 0:
        _logger.warning(
            "%s: contact of %s begins without history, as no pair of the checkpoint has the same "
            "surfaces and method: its force begins at zero, and bodies that it loaded start to "
            "move; give it the same surfaces, method and enforcement in both scenes to keep it",
            *(path, ", ".join(begun)),
        )
    if comm.rank == 0:
        _logger.info("%s was loaded at t = %g; not used: %s", path, stepper.t, "; ".join(dropped))
    return tuple(dropped)


def _without_motion(stepper: Stepper, comm: MPI.Comm) -> list[str]:
    """Set the velocity to zero in statics; return its name if it was not zero."""
    speed = reductions.largest(comm, float(np.abs(stepper.v.x.array).max(initial=0.0)))
    if not isinstance(stepper, QuasiStatic) or speed == 0.0:
        return []
    for body in stepper.bodies:
        stepper.set_velocity(body, np.zeros(dimension(body.V)))
    return ["velocities, which QuasiStatic does not have"]


def _bodies(scene: Mapping[str, str]) -> dict[str, str]:
    """Descriptions of the bodies in the fingerprint of a scene, by name."""
    return {name: text for name, text in scene.items() if name.startswith("body ")}


def _pairs(scene: Mapping[str, str]) -> list[int]:
    """Numbers of the pairs of a scene."""
    return sorted(int(name[5:]) for name in scene if name.startswith("pair "))


def _pairs_with_state(
    saved: Mapping[str, str], now: Mapping[str, str]
) -> tuple[dict[int, _Kept], dict[int, _Other]]:
    """Pairs that get a contact state of the checkpoint, and pairs with other laws.

    Both are by the number of the pair in the new scene, from 0.
    """
    kept, others = dict[int, _Kept](), dict[int, _Other]()
    numbers = {saved[f"pair {n}"]: n for n in _pairs(saved)}
    for i in _pairs(now):
        number = numbers.get(now[f"pair {i}"])
        if number is None:
            continue
        laws = [scene[f"laws of pair {n}"] for scene, n in ((saved, number), (now, i))]
        same = len({_MAY_CHANGE.sub("", law) for law in laws}) == 1
        if same or all(map(_has_no_springs, laws)):
            kept[i - 1] = _Kept(number, same or laws[0].endswith(", none"))
            continue
        text = (
            f"the laws are {laws[0]} in the checkpoint and {laws[1]} here, so that the contact "
            "force begins at zero and loaded bodies start to move; give the pair the same "
            "enforcement in both scenes to keep it"
        )
        others[i - 1] = _Other(number, text)
    return kept, others


def _has_no_springs(laws: str) -> bool:
    """Whether contact and friction are enforced by multipliers only."""
    return laws.startswith("LagrangeMultiplier") and ("eps_T=None" in laws or "none" in laws)
