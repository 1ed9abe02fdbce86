"""Robots as files, their simulation, and the fitness that it gives."""

import errno
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import GaitTimings
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.robot import FORMAT, Outcomes, Robot, simulate, stack, wave_robot
from caterpillar_env.task import EPISODE_S, Crawl, Failure
from caterpillar_env.validation.robots import random_robots
from evolution.config import RunConfig
from evolution.genome import Encoding
from evolution.run.evaluators import evaluate

PERIOD_S = RunConfig().gait_period_s
SHORT = Physics(num_segments=2, mismatch_seed=3, timestep_s=0.01)
GENOME = np.random.default_rng(2).random(12)

SIMULATED_PERIOD_S = 2.0
TWO_SEGMENTS = Physics(num_segments=2)
#: A stiffness and a timestep with which the integration diverges at once.
BROKEN = Physics(
    num_segments=2, integrator="implicitfast", timestep_s=0.01,
    axial_stiffness_n_m=1e5, axial_damping_n_s_m=0.0,
)  # fmt: skip


@pytest.fixture
def individual():
    return Encoding(SHORT, PERIOD_S).robot(GENOME, fitness_m=0.0123, generation=7)


def changed(individual, path, value):
    """Return the JSON of the robot with one value replaced, or removed if it is `...`."""
    data = json.loads(json.dumps(individual.to_dict()))
    *way, last = path
    place = data
    for key in way:
        place = place[key]
    if value is ...:
        del place[last]
    else:
        place[last] = value
    return data


def some(count, period_s=SIMULATED_PERIOD_S):
    """Bodies and gaits of random robots with two segments."""
    rng = np.random.default_rng(0)
    bodies = [Morphology.from_unit(rng.random(8)) for _ in range(count)]
    on_s, off_s = period_s * rng.random((2, count, 2))
    return bodies, GaitTimings(period_s, on_s, off_s)


def outcomes(failure, distance_m):
    nothing = np.zeros(len(failure))
    return Outcomes(np.array(failure, dtype=np.int8), np.array(distance_m), nothing, nothing)


# Robots as files


def test_robot_round_trips_exactly_through_its_file(individual, tmp_path):
    individual.save(tmp_path / "robot.json")
    again = Robot.load(tmp_path / "robot.json")
    assert again.morphology == individual.morphology
    assert again.physics == SHORT
    assert (again.fitness_m, again.generation) == (0.0123, 7)
    assert again.timings.period_s == PERIOD_S
    assert again.timings.on_s.tolist() == individual.timings.on_s.tolist()
    assert again.timings.off_s.tolist() == individual.timings.off_s.tolist()


def test_failed_save_keeps_the_existing_file(individual, tmp_path, monkeypatch):
    individual.save(tmp_path / "best.json")

    def stop_midway(path, data):
        path.write_text(data[:99].decode())
        raise OSError(errno.ENOSPC, "no space left")

    monkeypatch.setattr(Path, "write_bytes", stop_midway)
    with pytest.raises(CaterpillarError, match=r"best\.json: no space left; choose another place"):
        replace(individual, fitness_m=1.0).save(tmp_path / "best.json")
    assert Robot.load(tmp_path).fitness_m == 0.0123
    assert [file.name for file in tmp_path.iterdir()] == ["best.json"]


def test_run_folder_loads_its_best_robot(individual, tmp_path):
    individual.save(tmp_path / "best.json")
    assert Robot.load(tmp_path).to_dict() == individual.to_dict()


def test_a_damaged_file_gives_the_same_robot_or_an_error(individual, tmp_path):
    file = tmp_path / "best.json"
    individual.save(file)
    content, rng, refused = file.read_bytes(), np.random.default_rng(0), 0
    for place in rng.integers(0, len(content), 500):
        altered = bytearray(content)
        altered[place] ^= 1 << int(rng.integers(0, 8))
        file.write_bytes(altered)
        try:
            assert Robot.load(file).to_dict() == individual.to_dict()
        except CaterpillarError:
            refused += 1
    assert refused > 490  # the others change the name of the entry `digest`, so no digest is checked
    # A file without a digest may be edited.
    data = individual.to_dict() | {"fitness_m": 0.5}
    file.write_text(json.dumps(data))
    assert Robot.load(file).fitness_m == 0.5


def test_robots_can_be_members_of_sets(individual):
    other = individual.with_physics(friction=0.5)
    assert individual in {individual, other}
    assert [individual, other].index(other) == 1


def test_json_names_units_and_pairs(individual):
    data = individual.to_dict()
    assert data["format"] == FORMAT
    assert set(data["morphology"]) == {
        "leg_separation_m", "segment_length_m", "segment_radius_m", "segment_mass_kg",
        "joint_limit_rad", "attachment_x_m", "attachment_y_m", "attachment_z_m",
    }  # fmt: skip
    assert list(data["gait"]["pairs"]) == ["gap1_dorsal", "gap1_ventral"]
    assert set(data["gait"]["pairs"]["gap1_dorsal"]) == {"on_s", "off_s"}
    assert data["physics"]["num_segments"] == 2
    assert data["physics"]["spring"]["drive_current_a"] == SHORT.spring.drive_current_a


def test_loaded_robot_crawls_like_its_genome(individual, tmp_path):
    individual.save(tmp_path / "best.json")
    again = Robot.load(tmp_path).simulate(threads=1)
    ours = evaluate(GENOME[None], Encoding(SHORT, PERIOD_S), threads=1)
    assert again.distance_m[0] == ours.distance_m[0] != 0.0
    assert again.energy_j[0] == ours.energy_j[0]


@pytest.mark.parametrize(("kind", "size"), [("full", 16), ("per-segment", 20)])
def test_robots_of_every_encoding_round_trip(tmp_path, kind, size):
    genome = np.random.default_rng(2).random(size)
    Encoding(SHORT, PERIOD_S, kind).robot(genome).save(tmp_path / "best.json")
    again = Robot.load(tmp_path).simulate(threads=1)
    ours = evaluate(genome[None], Encoding(SHORT, PERIOD_S, kind), threads=1)
    assert again.distance_m[0] == ours.distance_m[0] != 0.0


def test_json_names_segments_and_springs():
    data = Encoding(SHORT, PERIOD_S, "full").robot(np.full(16, 0.3)).to_dict()
    assert list(data["gait"]["springs"])[:2] == ["gap1_dorsal_left", "gap1_dorsal_right"]
    parts = Encoding(SHORT, PERIOD_S, "per-segment").robot(np.full(20, 0.3)).to_dict()
    assert len(parts["morphology"]) == 2
    del parts["morphology"][1]
    with pytest.raises(CaterpillarError, match="all segments or a tuple of 2 morphologies; got 1"):
        Robot.from_dict(parts)


def test_different_timestep_simulates_the_same_robot(individual):
    own = individual.simulate(threads=1, duration_s=2.0)
    finer = individual.with_physics(timestep_s=SHORT.timestep_s / 2).simulate(threads=1, duration_s=2.0)
    assert finer.distance_m[0] != own.distance_m[0]
    assert finer.energy_j[0] == own.energy_j[0]  # heat does not depend on the motion
    assert individual.physics.timestep_s == SHORT.timestep_s


def test_timestep_that_does_not_divide_the_thermal_step_is_rejected(individual):
    for timestep_s in (0.003, 0.0, -0.005, np.nan):
        with pytest.raises(CaterpillarError, match="timestep_s"):
            individual.with_physics(timestep_s=timestep_s)


def test_record_is_optional(individual):
    data = changed(individual, ["fitness_m"], ...)
    assert Robot.from_dict(data).fitness_m is None


@pytest.mark.parametrize("data", [None, [], "robot", 3, {}, {"format": "caterpillar-individual-0"}])
def test_json_without_a_robot_is_rejected(data):
    with pytest.raises(CaterpillarError, match=FORMAT):
        Robot.from_dict(data)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (["morphology"], ...),
        (["morphology", "segment_mass_kg"], ...),
        (["morphology", "segment_mass_kg"], 12.0),
        (["morphology", "segment_mass_kg"], None),
        (["morphology"], "long"),
        (["gait"], ...),
        (["gait"], []),
        (["gait", "period_s"], ...),
        (["gait", "period_s"], 0.0),
        (["gait", "period_s"], "three"),
        (["gait", "pairs"], None),
        (["gait", "pairs", "gap1_dorsal"], ...),
        (["gait", "pairs", "gap2_dorsal"], {"on_s": 0.0, "off_s": 1.0}),
        (["gait", "pairs", "gap1_dorsal", "on_s"], ...),
        (["gait", "pairs", "gap1_dorsal", "on_s"], -0.5),
        (["gait", "pairs", "gap1_dorsal", "on_s"], PERIOD_S + 0.1),
        (["gait", "pairs", "gap1_dorsal", "on_s"], None),
        (["gait", "pairs", "gap1_dorsal", "on_s"], "soon"),
        (["gait", "pairs", "gap1_dorsal", "on_s"], [0.5, 1.0]),
        (["gait", "pairs", "gap1_dorsal", "on_s"], float("nan")),
        (["physics"], ...),
        (["physics"], [1]),
        (["physics", "gravity"], 1.6),
        (["physics", "num_segments"], 4),
        (["physics", "num_segments"], 1),
        (["physics", "num_segments"], "four"),
        (["physics", "mismatch_seed"], 0.5),
        (["physics", "solver_iterations"], 10.5),
        (["physics", "spring", "turns"], -1),
    ],
    ids=str,
)
def test_error_of_an_invalid_robot_names_the_file(individual, tmp_path, path, value):
    file = tmp_path / "robot.json"
    file.write_text(json.dumps(changed(individual, path, value)))
    with pytest.raises(CaterpillarError, match=r"robot\.json"):
        Robot.load(file)


def test_times_in_lists_are_rejected(individual, tmp_path):
    listed = {"on_s": [0.0], "off_s": [1.0]}
    data = changed(individual, ["gait", "pairs"], {"gap1_dorsal": listed, "gap1_ventral": listed})
    with pytest.raises(CaterpillarError):
        Robot.from_dict(data)


def test_error_of_a_long_robot_is_one_line():
    timings = GaitTimings(PERIOD_S, np.zeros(38), np.ones(38))
    long = Robot(Morphology(), timings, Physics(num_segments=20))
    data = changed(long, ["gait", "pairs", "gap1_dorsal", "on_s"], PERIOD_S + 1.0)
    with pytest.raises(CaterpillarError) as refused:
        Robot.from_dict(data)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe\x00", b"[1,"])
def test_file_that_is_not_json_is_rejected(tmp_path, content):
    (tmp_path / "robot.json").write_bytes(content)
    with pytest.raises(CaterpillarError, match="is not JSON"):
        Robot.load(tmp_path / "robot.json")


def test_missing_file_and_empty_folder_are_rejected(tmp_path):
    for path, message in ((tmp_path / "none.json", "cannot read"), (tmp_path, "holds no best.json")):
        with pytest.raises(CaterpillarError, match=message):
            Robot.load(path)


def test_robot_from_a_genome_has_unbatched_timings(individual):
    assert individual.timings.on_s.shape == (2,)
    assert isinstance(individual.timings, GaitTimings)


def test_path_may_be_a_string(tmp_path):
    timings = GaitTimings(5.0, np.zeros(6), np.ones(6))
    robot = Robot(Morphology(), timings, Physics(), 0.1, generation=2, evaluation=41)
    robot.save(str(tmp_path / "best.json"))
    for path in (tmp_path, tmp_path / "best.json"):
        assert Robot.load(str(path)).digest == robot.digest
        assert Robot.load(path).evaluation == 41


# From outcomes to fitness


def test_fitness_of_a_sound_robot_is_its_distance():
    assert outcomes([0, 0], [0.05, 0.001]).fitness().tolist() == [0.05, 0.001]


def test_fitness_of_a_robot_that_crawls_backwards_is_0():
    assert outcomes([0], [-0.02]).fitness().tolist() == [0.0]


@pytest.mark.parametrize("failure", [f for f in Failure if f is not Failure.NONE])
def test_fitness_of_a_failed_robot_is_0(failure):
    assert outcomes([failure], [0.5]).fitness().tolist() == [0.0]


@pytest.mark.parametrize("distance", [np.nan, np.inf, -np.inf, 1e300])
def test_distance_of_a_diverged_robot_never_becomes_fitness(distance):
    fitness = outcomes([Failure.DIVERGED, Failure.NONE], [distance, 0.03]).fitness()
    assert fitness.tolist() == [0.0, 0.03]


# Simulating


def test_a_robot_crawls_for_thirty_seconds_of_simulated_time():
    result = simulate(*some(1), TWO_SEGMENTS, threads=1)
    assert EPISODE_S == 30.0
    assert result.failure.tolist() == [Failure.NONE]
    assert result.simulated_s == pytest.approx(30.0)
    assert result.energy_j[0] > 0


def test_robot_without_power_uses_no_energy_and_hardly_moves():
    never = GaitTimings(SIMULATED_PERIOD_S, np.ones((1, 2)), np.ones((1, 2)))
    result = simulate([Morphology()], never, TWO_SEGMENTS, threads=1, duration_s=3.0)
    assert result.energy_j.tolist() == [0.0]
    assert abs(result.distance_m[0]) < 1e-3


def test_gait_is_repeated_every_period():
    # The springs are powered for the first 0.2 s of every 2 s, too short to reach the cut-off
    # temperature. Two pulses fall within 3 s.
    pulse = GaitTimings(2.0, np.zeros((1, 2)), np.full((1, 2), 0.2))
    energies = [
        simulate([Morphology()], pulse, TWO_SEGMENTS, threads=1, duration_s=t).energy_j[0]
        for t in (0.1, 1.0, 3.0, 5.0)
    ]
    # Two pairs of springs for 0.2 s.
    assert energies[1] == pytest.approx(4 * TWO_SEGMENTS.spring.drive_power_w * 0.2, rel=1e-9)
    assert np.array(energies) / energies[1] == pytest.approx([0.5, 1.0, 2.0, 3.0], rel=1e-9)


def test_function_gets_the_trace_of_every_control_interval():
    traces = []
    simulate(*some(2), TWO_SEGMENTS, threads=1, duration_s=1.5, on_interval=traces.append)
    assert [trace.energy_j.shape[1] for trace in traces] == [10] * 15


def test_diverged_robot_stops_at_once_with_finite_fitness(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo logs its warning in the working directory
    result = simulate(*some(2), BROKEN, threads=1)
    assert result.failure.tolist() == [Failure.DIVERGED] * 2
    assert np.all(result.simulated_s < 30.0)
    assert result.fitness().tolist() == [0.0, 0.0]


@pytest.mark.parametrize("distance_m", [np.nan, np.inf, 7.0])
def test_distance_of_a_diverged_robot_is_0(monkeypatch, distance_m):
    progress = Crawl.progress

    def diverged(self, rows=None):
        found = progress(self, rows)
        failure = np.full_like(found.failure, Failure.DIVERGED)
        return found._replace(distance_m=np.full_like(found.distance_m, distance_m), failure=failure)

    monkeypatch.setattr(Crawl, "progress", diverged)
    outcomes = simulate(*some(1), TWO_SEGMENTS, threads=1, duration_s=0.1)
    assert outcomes.distance_m.tolist() == [0.0]


def test_failed_robots_stop_while_others_continue():
    # Limp, undamped necks: some of these bodies tip over within the first seconds.
    limp = Physics(num_segments=2, neck_stiffness_n_m_rad=1e-4, neck_damping_n_m_s_rad=0.0)
    result = simulate(*some(20, 3.0), limp, threads=2, duration_s=3.0)
    failed = result.failure != Failure.NONE
    assert 0 < failed.sum() < 20, "some robots must fail, and others must not"
    assert result.simulated_s[failed].min() < 1.0
    assert result.simulated_s[~failed] == pytest.approx(3.0)
    assert np.all(result.fitness()[failed] == 0)


@pytest.mark.parametrize("period_s", [0.25, 0.04, 3.01])
def test_period_off_the_control_interval_is_refused(period_s):
    with pytest.raises(CaterpillarError, match=r"multiple of 0\.1 s"):
        simulate(*some(1, period_s), TWO_SEGMENTS)


@pytest.mark.parametrize("duration_s", [0.0, -1.0, 0.15])
def test_duration_off_the_control_interval_is_refused(duration_s):
    with pytest.raises(CaterpillarError, match="the duration"):
        simulate(*some(1), TWO_SEGMENTS, duration_s=duration_s)


def test_negative_threads_are_refused():
    with pytest.raises(CaterpillarError, match="threads"):
        simulate(*some(1), TWO_SEGMENTS, threads=-1)


# Groups of robots


def test_joined_outcomes_have_all_robots_in_order():
    parts = [outcomes([0, Failure.TIPPED], [0.1, 0.2]), outcomes([0], [0.3])]
    joined = Outcomes.join(parts)
    assert joined.distance_m.tolist() == [0.1, 0.2, 0.3]
    assert joined.failure.tolist() == [0, Failure.TIPPED, 0]
    assert joined.rows(slice(1, 3)).distance_m.tolist() == [0.2, 0.3]


def test_robots_of_different_periods_or_springs_are_not_stacked():
    robots = random_robots(2, 0, Physics())
    bodies, timings = stack(robots)
    assert bodies == [robot.morphology for robot in robots]
    np.testing.assert_array_equal(timings.on_s[1], robots[1].timings.on_s)
    short = Robot(Morphology(), GaitTimings(2.0, np.zeros(6), np.ones(6)), Physics())
    for other in (short, wave_robot_of_springs()):
        with pytest.raises(CaterpillarError, match="the same gait period and the same number"):
            stack([robots[0], other])


def wave_robot_of_springs():
    wave = wave_robot()
    return Robot(wave.morphology, wave.timings.mirrored(), wave.physics)


def test_wave_robot_crawls_as_far_as_the_documentation_says():
    assert wave_robot().simulate().distance_m == pytest.approx(0.177, abs=5e-4)
