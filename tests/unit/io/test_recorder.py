"""Files of the recorder, read back by VTK and computed again in NumPy."""

import csv
import logging
import re

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.io.recorder import Recorder
from dolfinx_nts.solvers import newton
from helpers.models import box_meshes
from helpers.once import once
from helpers.readers import read_grids
from helpers.scenes import BLOCK_RUBBER, BLOCK_STEP, blocks
from reference.bulk import Bulk

TOLERANCE = 1e-12

FIRST_COLUMNS = (
    "step,time,dt,kinetic_energy,strain_energy,contact_energy,total_energy,"
    "linear_momentum_x,linear_momentum_y,linear_momentum_z,"
    "angular_momentum_x,angular_momentum_y,angular_momentum_z,"
    "contact_force_x,contact_force_y,contact_force_z,"
    "active_nodes,min_gap,newton_iterations,rejected"
)
LEDGER = (
    "bulk,loads,supports,obstacles,damping,persistent_contact,activation,facet_change,"
    "friction,solver,surface_equilibrium,refund,unaccounted"
)


def record(stepper, path, num_steps, **options):
    """Record some steps. Collective."""
    with Recorder(path, stepper, **options) as recorder:
        for step in stepper.run(until=stepper.t + num_steps * stepper.dt):
            recorder.write(step)
    return recorder


def read_table(path):
    """Read the columns as arrays."""
    with open(path, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("scheme", [once(nts.Midpoint), nts.EnergyMomentum])
@pytest.mark.parametrize("impact", [once("elastic"), "plastic"])
def test_table_agrees_with_the_fields_read_back(comm, folder, agree, scheme, impact):
    scene = blocks(comm, scheme, nts.LagrangeMultiplier(impact))
    record(scene.stepper, folder / "run", 6)
    table = read_table(folder / "run.csv")
    times, grids = read_grids(folder / "run.vtkhdf")

    cells = grids[0].cells_dict[12][:, [0, 1, 3, 2, 4, 5, 7, 6]]
    E, nu, rho = BLOCK_RUBBER
    lmbda, mu = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))
    bulk = Bulk(grids[0].points, cells, lmbda=lmbda, mu=mu, rho=rho)
    x = np.array([grid.points + grid["displacement"] for grid in grids])
    v = np.array([grid["velocity"] for grid in grids])
    K = np.array([bulk.kinetic_energy(state) for state in v])
    strain = np.array([bulk.strain_energy(state) for state in x])
    momenta = np.array([bulk.momenta(*state) for state in zip(x, v, strict=True)])
    defect = np.zeros(7)
    for i in range(6):
        x_mid = (x[i] + x[i + 1]) / 2
        states = (x_mid, x_mid) if scheme is nts.Midpoint else (x[i], x[i + 1])
        work = bulk.internal(*states)[0] @ (x[i + 1] - x[i]).ravel()
        defect[i + 1] = defect[i] + strain[i + 1] - strain[i] - work

    columns = [f"{kind}_momentum_{axis}" for kind in ("linear", "angular") for axis in "xyz"]
    causes = np.array([table[f"energy_{cause}"] for cause in LEDGER.split(",")])
    active = np.array([grid["active"] for grid in grids])
    pressure = np.array([grid["contact_pressure"] for grid in grids])
    gap = np.array([grid["gap"] for grid in grids])
    change = table["total_energy"] - table["total_energy"][0]
    atol = TOLERANCE * K[0]
    checks = {
        "time": np.allclose(times, table["time"], rtol=0, atol=1e-15),
        "step": np.array_equal(table["step"], range(7)),
        "dt": np.allclose(table["dt"], [0, *[BLOCK_STEP] * 6]),
        "kinetic": np.allclose(table["kinetic_energy"], K, rtol=0, atol=atol),
        "strain": np.allclose(table["strain_energy"], strain, rtol=0, atol=atol),
        "momenta": all(
            np.allclose(table[name], value, rtol=0, atol=atol)
            for name, value in zip(columns, momenta.T, strict=True)
        ),
        "bulk": np.allclose(table["energy_bulk"], defect, rtol=0, atol=atol),
        "ledger": np.allclose(causes.sum(axis=0), change, rtol=0, atol=1e-3 * atol),
        "closing": np.abs(table["energy_unaccounted"]).max() < atol,
        "conserved": scheme is nts.Midpoint or impact == "plastic" or abs(change).max() < 10 * atol,
        "loss": impact == "elastic" or table["energy_activation"][-1] < -1e-6 * K[0],
        "active": np.array_equal(active.sum(axis=1), table["active_nodes"]) and active.any(),
        "pressure": np.array_equal(pressure > 0, active == 1) and pressure.min() >= 0,
        "gap": np.allclose(np.nanmin(gap, axis=1), table["min_gap"], rtol=0, atol=TOLERANCE),
        "surface": np.isnan(gap).any() and not np.isnan(gap[active == 1]).any(),
        "body": np.array_equal(np.bincount(grids[-1]["body"].astype(int)), [9, 4]),
    }
    assert agree(all(checks.values())), {name for name, passed in checks.items() if not passed}


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("enforcement", [nts.LagrangeMultiplier("plastic"), once(nts.Penalty())])
def test_ledger_closes_with_friction_and_springs(comm, folder, agree, enforcement):
    old = blocks(comm).stepper
    pairs = [
        nts.ContactPair(
            p.nodes, p.segments, enforcement, nts.Coulomb(0.3), method="node-to-segment"
        )
        for p in old.pairs
    ]
    stepper = nts.EnergyMomentum(old.bodies, pairs, dt=BLOCK_STEP)
    stepper.v.x.array[:] = old.v.x.array
    record(stepper, folder / "run", 6)
    table = read_table(folder / "run.csv")
    atol = TOLERANCE * table["kinetic_energy"][0]
    assert agree(np.abs(table["energy_unaccounted"]).max() < atol)
    assert agree(table["energy_friction"][-1] < -1e6 * atol)
    assert agree(np.all(np.diff(table["friction_dissipation"]) >= 0))
    assert agree(table["friction_dissipation"][-1] == -table["energy_friction"][-1])
    assert agree(table["contact_energy"].any() == isinstance(enforcement, nts.Penalty))


@pytest.mark.at_most_two_ranks
def test_columns_are_named_in_words_and_parts_have_the_numbers_of_the_api(comm, folder, agree):
    old = blocks(comm).stepper
    (pair,) = old.pairs
    bottom = fem.locate_dofs_geometrical(pair.nodes.V, lambda x: x[2] < 0.02)
    bcs = [fem.dirichletbc(np.zeros(3), bottom, pair.nodes.V)]
    loads = [nts.Gravity(old.bodies, (0, 0, -1)), nts.Traction(pair.segments, (0, 0, 1))]
    pairs = [
        nts.ContactPair(
            pair.nodes,
            pair.segments,
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        )
    ]
    stepper = nts.EnergyMomentum(old.bodies, pairs, dt=BLOCK_STEP, bcs=bcs, loads=loads)
    stepper.v.x.array[:] = old.v.x.array
    reports = []
    parts = ("loads", "bodies", "supports", "pairs")
    with Recorder(folder / "run", stepper, columns_of=parts) as recorder:
        for step in stepper.run(until=5 * BLOCK_STEP):
            recorder.write(step)
            reports.append(step)
    table = read_table(folder / "run.csv")
    ledger = "".join(f",energy_{cause}" for cause in LEDGER.split(","))
    totals = f"{FIRST_COLUMNS}{ledger},external_work,friction_dissipation".split(",")
    contact = recorder.diagnostics.pairs()["surface_3_surface_2"]
    of_bodies = {f"body_{n}_": body for n, body in recorder.diagnostics.bodies().items()}
    works = [[r.load_works[0], r.load_works[1], r.reactions[0].work] for r in reports]
    last = reports[-1].reactions[0]
    expected = contact.columns("pair_surface_3_surface_2_")
    for kind, vector in (("force", last.force), ("moment", last.moment)):
        expected |= {f"support_1_{kind}_{axis}": v for axis, v in zip("xyz", vector, strict=True)}
    gravity, traction, support = np.sum(works, axis=0)
    expected |= {"support_1_work": support, "load_gravity_work": gravity}
    expected |= {"load_traction_surface_2_work": traction}
    for prefix, part in of_bodies.items():
        expected |= part.columns(prefix)
    assert agree(list(table) == [*totals, *expected])
    assert agree(all(table[name][-1] == value for name, value in expected.items()))
    assert agree(len(of_bodies) == 2 and contact.contact_area > 0)
    loads = table["load_gravity_work"] + table["load_traction_surface_2_work"]
    assert agree(np.allclose(loads, table["energy_loads"], rtol=1e-12))


@pytest.mark.at_most_two_ranks
def test_table_has_the_columns_of_the_parts_that_are_asked_for(comm, folder, refused):
    record(blocks(comm).stepper, folder / "run", 1, columns_of=())
    columns = (folder / "run.csv").read_text().splitlines()[0]
    assert columns.endswith(",energy_unaccounted,external_work,friction_dissipation")
    with refused(ValueError, r"columns_of some of 'pairs', .*, given \['body'\]"):
        Recorder(folder / "run", blocks(comm).stepper, columns_of=["body"])


@pytest.mark.at_most_two_ranks
def test_fields_come_every_so_many_steps_and_at_the_end(comm, folder, agree):
    record(blocks(comm, num_bodies=3).stepper, folder / "run", 5, every=3)
    times, _ = read_grids(folder / "run.vtkhdf")
    assert agree(np.allclose(times, BLOCK_STEP * np.array([0, 3, 5])))
    assert agree(len(read_table(folder / "run.csv")["time"]) == 6)


@pytest.mark.at_most_two_ranks
def test_files_without_pairs_have_no_contact_fields(comm, folder, agree):
    scene = blocks(comm)
    stepper = nts.Midpoint(scene.stepper.bodies, dt=BLOCK_STEP)
    record(stepper, folder / "run", 2)
    _, grids = read_grids(folder / "run.vtkhdf")
    assert agree(set(grids[0].point_data) == {"displacement", "velocity"})
    assert agree(set(grids[0].cell_data) == {"body"})
    assert agree(np.isnan(read_table(folder / "run.csv")["min_gap"]).all())


@pytest.mark.at_most_two_ranks
def test_files_are_valid_after_an_exception_in_the_loop(comm, folder, agree):
    stepper = blocks(comm).stepper
    with pytest.raises(ZeroDivisionError), Recorder(folder / "run", stepper) as recorder:
        for step in stepper.run(until=1.0):
            recorder.write(step)
            if step.step == 2:
                raise ZeroDivisionError
    # After an error the first rank closes the files alone.
    comm.barrier()
    times, _ = read_grids(folder / "run.vtkhdf")
    assert agree(len(times) == 3)
    assert agree(len(read_table(folder / "run.csv")["time"]) == 3)


def test_a_failed_step_leaves_the_last_state_in_the_files(comm, folder, agree, monkeypatch):
    stepper = blocks(comm).stepper
    with pytest.raises(nts.ConvergenceError), Recorder(folder / "run", stepper, every=9) as r:
        for step in stepper.run(until=1.0):
            r.write(step)
            if step.step == 3:
                monkeypatch.setattr(newton, "_MAX_ITERATIONS", 0)
    times, grids = read_grids(folder / "run.vtkhdf")
    largest = comm.allreduce(np.abs(stepper.u.x.array).max(), op=MPI.MAX)
    assert agree(np.allclose(times, [0, 3 * BLOCK_STEP]))
    assert agree(np.abs(grids[-1]["displacement"]).max() == largest)
    assert agree(len(read_table(folder / "run.csv")["time"]) == 4)


@pytest.mark.at_most_two_ranks
def test_rows_and_states_can_be_read_at_once(comm, folder, agree):
    stepper = blocks(comm).stepper
    with Recorder(folder / "run", stepper, fields="xdmf") as recorder:
        for step in stepper.run(until=3 * BLOCK_STEP):
            recorder.write(step)
            comm.barrier()
            table = read_table(folder / "run.csv")
            assert agree(table["step"][-1] == step.step and "energy_unaccounted" in table)
            times, _ = read_grids(folder / "run.xdmf")
            assert agree(np.allclose(times, table["time"], rtol=0, atol=1e-15))
            comm.barrier()
    assert stepper.step == 3


@pytest.mark.at_most_two_ranks
def test_files_of_the_same_name_are_replaced(comm, folder, agree):
    stepper = blocks(comm).stepper
    record(stepper, folder / "run", 3)
    record(stepper, folder / "run", 1)
    times, _ = read_grids(folder / "run.vtkhdf")
    table = read_table(folder / "run.csv")
    assert agree(np.allclose(times, BLOCK_STEP * np.array([3, 4])))
    assert agree(np.array_equal(table["step"], [3, 4]) and table["energy_solver"][0] == 0)


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(
    "name", ["run.csv", "run.vtkhdf", "run_fields/grid.h5", "run_fields/000000007-000000009.h5"]
)
def test_nothing_is_created_when_a_file_cannot_be(comm, folder, refused, name):
    stepper = blocks(comm).stepper
    with refused(FileNotFoundError, "expected an existing folder, given .*nowhere"):
        record(stepper, folder / "nowhere" / "run", 1)
    if comm.rank == 0:
        (folder / name).mkdir(parents=True)
    comm.barrier()
    with refused(OSError, f"expected a file that can be replaced, given .*{name}"):
        record(stepper, folder / "run", 1)
    assert [path.name for path in folder.iterdir()] == [name.split("/")[0]]
    assert stepper.step == 0


def test_nothing_is_created_when_the_folder_of_the_fields_is_a_file(comm, folder, refused):
    if comm.rank == 0:
        (folder / "run_fields").write_text("mine")
    comm.barrier()
    with refused(OSError, "expected a folder in which files can be replaced, given .*run_fields"):
        record(blocks(comm).stepper, folder / "run", 1)
    assert [path.name for path in folder.iterdir()] == ["run_fields"]


@pytest.mark.at_most_two_ranks
def test_stress_and_fields_of_the_user_are_in_the_files_also_after_resuming(comm, folder, agree):
    def part(until):
        stepper = blocks(comm).stepper
        V = stepper.u.function_space
        f = fem.Function(fem.functionspace(V.mesh, ("Lagrange", 1)))
        f.interpolate(lambda x: x[0] + 2 * x[1])
        with Recorder(
            *(folder / "run", stepper),
            stress=True,
            checkpoint_every=1,
            resume=True,
            own_columns={"time_twice": lambda s: 2 * s.t, "place": lambda s: (s.t, 0.0, 1.0)},
            own_fields={"f": f, "x": lambda s: s.x[: len(s.node_ids)]},
        ) as recorder:
            for step in stepper.run(until=until * BLOCK_STEP):
                recorder.write(step)
                f.x.array[:] += 1.0
        return stepper, f

    part(2)
    stepper, _ = part(4)
    table = read_table(folder / "run.csv")
    names = ["time_twice", "place_x", "place_y", "place_z"]
    assert agree(list(table)[-4:] == names)
    assert agree(np.array_equal(table["time_twice"], 2 * table["time"]))
    _, grids = read_grids(folder / "run.vtkhdf")
    assert agree(len(grids) == 5)
    fields = nts.Fields(stepper)
    for name, function in (
        ("cauchy_stress", fields.cauchy_stress()),
        ("von_mises_stress", fields.von_mises_stress()),
        ("strain_energy_density", fields.strain_energy_density()),
    ):
        written = grids[-1].cell_data[name]
        own = function.x.array.reshape(-1, *written.shape[1:])
        mesh = stepper.u.function_space.mesh
        cells = np.arange(mesh.topology.index_map(3).size_local)
        original = mesh.topology.original_cell_index[cells]
        dofs = function.function_space.dofmap.list[cells, 0]
        assert agree(np.array_equal(written[original], own[dofs])), name
        assert agree(np.abs(written).max() > 0)
    assert agree(np.allclose(grids[-1]["x"], grids[-1].points + grids[-1]["displacement"]))
    added = [grid["f"] - grid.points @ [1.0, 2.0, 0.0] for grid in grids]
    # Each run began with 0 and added 1 after a step was written.
    assert agree(np.allclose(added, np.array([0, 0, 1, 0, 1])[:, None], rtol=0, atol=1e-12))


@pytest.mark.at_most_two_ranks
def test_columns_and_fields_of_the_user_that_do_not_fit_are_refused(comm, folder, refused):
    stepper = blocks(comm).stepper
    V = stepper.u.function_space

    def enter(**options):
        with Recorder(folder / "run", stepper, **options):
            pass

    for column, reason in (
        ({"dt": lambda s: 1.0}, "names that no other column has, given 'dt'"),
        ({"two": lambda s: (1.0, 2.0)}, r"a number or three for the column two, given \(2,\)"),
    ):
        with refused(ValueError, reason):
            enter(own_columns=column)
    with refused(ZeroDivisionError, "by zero"):
        enter(own_columns={"bad": lambda s: 1 / 0 if comm.rank == comm.size - 1 else 1.0})
    constant = fem.Function(fem.functionspace(V.mesh, ("DG", 0)))
    for field, reason in (
        ({"gap": lambda s: s.x}, "names that no other field has, given 'gap'"),
        ({"two": lambda s: np.ones(3 * len(s.x))}, "with a row for each owned node, given"),
        ({"c": constant}, "a Lagrange Function of degree 1, scalar or of three components"),
        ({"a b": constant}, "names of own_fields made of letters, digits and _, given 'a b'"),
    ):
        with refused(ValueError, reason):
            enter(own_fields=field)
    with refused(ValueError, "fields='vtkhdf' with stress, given 'vtx'"):
        enter(stress=True, fields="vtx")


@pytest.mark.at_most_two_ranks
def test_it_prints_its_arguments(comm, folder, monkeypatch):
    monkeypatch.chdir(folder)
    recorder = Recorder("run", blocks(comm).stepper, times=[0.1, np.float64(0.25)], resume=True)
    assert repr(recorder) == (
        "Recorder(name='run', stepper=EnergyMomentum, every=1, times=(0.1, 0.25), "
        "checkpoint_every=None, resume=True, "
        "columns_of=('pairs', 'between', 'obstacles', 'supports', 'loads'), stress=False, "
        "own_columns=(), own_fields=(), fields='vtkhdf')"
    )


@pytest.mark.at_most_two_ranks
def test_wrong_use_is_refused(comm, folder, refused):
    stepper = blocks(comm).stepper
    with refused(ValueError, "every >= 1, given 0"):
        Recorder(folder / "run", stepper, every=0)
    recorder = Recorder(folder / "run", stepper)
    step = stepper.advance()
    with refused(ValueError, r"expected write\(\) inside the with block"):
        recorder.write(step)
    with refused(ValueError, r"expected summary\(\) in or after the with block"):
        recorder.summary()
    with recorder:
        stepper.advance()
        with refused(ValueError, "next for step 2, given step 3 after 3 steps"):
            recorder.write(stepper.advance())


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("checkpoint_every", [None, 2])
def test_an_immediate_interrupt_logs_how_to_continue(comm, folder, caplog, checkpoint_every):
    stepper = blocks(comm).stepper
    with (
        pytest.raises(KeyboardInterrupt),
        Recorder(folder / "run", stepper, checkpoint_every=checkpoint_every) as recorder,
    ):
        for step in stepper.run(until=1.0):
            if step.step == 4:
                raise KeyboardInterrupt
            recorder.write(step)
    messages = [record.getMessage() for record in caplog.records]
    assert len(messages) == (comm.rank == 0)
    text = "step after 3; .*run.checkpoint.h5 holds step 2, t = 0.04: the same script with .*resume"
    if checkpoint_every is None:
        text = "step after 3; there is no checkpoint: with .*checkpoint_every=50, resume=True"
    assert all(re.search(text, message) for message in messages)


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("dt", [0.01, 0.04])
@pytest.mark.parametrize(
    "scheme", [once(nts.Midpoint), once(nts.GeneralizedAlpha), once(nts.EnergyMomentum)]
)
def test_a_scheme_that_multiplies_the_energy_is_reported_once(comm, folder, caplog, scheme, dt):
    data = box_meshes.boxes([(1, 1, 2)], [(0.2, 0.2, 1.0)])
    mesh, cells, _, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    bar = nts.Body(V, cells, tag["body 0"], nts.SaintVenantKirchhoff(1e6, 0.3, 1e3))
    stepper = scheme([bar], dt=dt)
    stepper.set_velocity(bar, lambda X: 20 * np.array([0.5 - X[2], 0 * X[0], X[0] - 0.1]))
    ledger = record(stepper, folder / "run", 6)._ledger
    grows = ledger.last.total_energy > 1.5 * ledger.first.total_energy
    assert grows == (dt == 0.04 and scheme is not nts.EnergyMomentum)
    messages = [r.getMessage() for r in caplog.records if "use EnergyMomentum" in r.getMessage()]
    assert len(messages) == (grows and comm.rank == 0)
    assert all(f"{scheme.__name__} has added " in text for text in messages)


def test_the_summary_of_a_run_that_goes_on_has_the_time_until_now(comm, folder):
    stepper = blocks(comm).stepper
    with nts.Recorder(folder / "run", stepper) as recorder:
        for step in stepper.run(until=2 * stepper.dt):
            recorder.write(step)
        *_, times = recorder.summary().splitlines()
    assert float(re.search(r"other (-?[\d.]+)", times)[1]) >= 0


@pytest.mark.at_most_two_ranks
def test_the_summary_counts_and_is_logged_on_the_first_rank(comm, folder, caplog):
    stepper = blocks(comm).stepper
    with caplog.at_level(logging.INFO, logger="dolfinx_nts"):
        text = record(stepper, folder / "run", 4).summary()
    iterations = read_table(folder / "run.csv")["newton_iterations"]
    assert "4 steps from t = 0 to 0.08 s" in text
    assert f"Newton iterations: {sum(iterations):.0f}, mean {iterations[1:].mean():.2f}" in text
    results, solver = text.split("\nsolver\n")
    assert "energy unaccounted for: at most" in results
    assert "Newton iterations" in solver and "wall time" in solver
    assert "output" in text
    assert (text.splitlines()[0] in caplog.text) == (comm.rank == 0)
