"""Request of a run, and the checks that are possible before anything moves."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from drivers.rig_file import ResidualSpec, Rig, load_rig
from drivers.signals import ConfigurationError
from drivers.virtual import is_own_rig
from hil.profile import WINDOW_S, Profile, SetpointLimit, read_profile, validate
from hil.rig import unguarded
from hil.run.outputs import setpoint_columns
from hil.run_folder import Labels
from hil.served_rig import INVERSE_CRIME
from hil.testing import PreparedTest, prepared_test
from hil.tracking import DEFAULT, STATIC, NetworkMode, TrackingConfig

if TYPE_CHECKING:
    from twin import Network

Mode = Literal["real", "scaled", "lockstep"]
MOST_SPEED = 100.0
"""Greatest factor to real time: beyond it a watchdog of seconds is shorter than a delay of the scheduler. Lockstep has
no such limit."""


@dataclass(frozen=True, slots=True)
class RunRequest:
    """Files and options of a run.

    Attributes
    ----------
    profile
        Load profile.
    rig
        Rig file.
    twin
        Twin file; None takes the twin that the rig file names, if any.
    runs
        Folder for the new run folder.
    virtual
        Start a virtual rig in place of the one at the rig file's addresses: the built-in one where the file describes
        that, else its devices as the file describes them.
    mode
        Clock of the run: real time, scaled time, or lockstep.
    speed
        Factor to real time in mode "scaled".
    seed
        Seed of the virtual rig and the calibrators.
    effects
        Effects of the virtual rig that no twin contains.
    calibrators
        Names; None takes the usual ones, without those that this twin does not admit.
    card
        Model card of the trained ensemble for the network calibrators, None for the shipped one.
    network_mode
        See `hil.tracking.adoption`.
    viewer
        Open Rerun; None opens it where there is a display.
    use_twin
        False runs without a twin.
    control
        Host and port of a virtual rig in lockstep that runs already, at the rig file's addresses.
    rearm
        Acknowledge a trip that the rig has at the start.
    diagnose_s
        Profile time between diagnoses of the record so far, s; infinity diagnoses the whole run only.
    healthy
        Healthy record for the diagnosis.
    adopt
        Save the revision of the twin that a diagnosis makes.
    guardian
        False runs without the process that makes the rig safe when this one is killed or hangs.
    no_lock
        Run although the locks of the rig cannot be taken.
    report
        False leaves out review and report; `hil report` makes them from the journal.
    start_s
        Rig time at which a virtual rig starts, s: the age of its effects.
    test
        Test plan whose limits are judged, live and at the end.
    labels
        Test object, serial number, operator and tags.
    """

    profile: Path
    rig: Path
    twin: Path | None
    runs: Path
    virtual: bool = False
    mode: Mode = "real"
    speed: float = 1.0
    seed: int = 0
    effects: Path | None = None
    calibrators: tuple[str, ...] | None = None
    card: Path | None = None
    network_mode: NetworkMode = "shadow"
    viewer: bool | None = None
    use_twin: bool = True
    control: tuple[str, int] | None = None
    rearm: bool = False
    diagnose_s: float | None = None
    healthy: Path | None = None
    adopt: bool = False
    guardian: bool = True
    no_lock: bool = False
    report: bool = True
    start_s: float = 0.0
    test: Path | None = None
    labels: Labels = field(default_factory=Labels)


@dataclass(frozen=True, slots=True)
class RunInputs:
    """Checked files of a run, with its test, if any, and notes for the operator."""

    rig: Rig
    profile: Profile
    twin: Path | None
    network: Network | None
    notes: tuple[str, ...]
    test: PreparedTest | None = None


def prepare(request: RunRequest) -> RunInputs:
    """Return all files of a run, read and validated; raises the error of a file, or ConfigurationError."""
    rig = load_rig(request.rig)
    profile = read_profile(request.profile)
    twin = (request.twin or rig.twin) if request.use_twin else None
    least_s = 0.0 if twin is None else WINDOW_S
    notes = validate(profile, setpoint_limits(rig), min_duration_s=least_s, period_s=rig.period_s)
    notes = [*unguarded(rig, request.rig), *notes]
    network = None
    if twin is not None:
        from twin import load

        network = load(twin)
        notes = [*notes, *_check_twin_columns(twin, network, rig)]
        check_calibrators(request.calibrators)
        chosen_calibrators(request.calibrators, request.card)
    elif request.card is not None:
        raise ConfigurationError(
            "--network belongs to a calibrator, and this run has no twin; name one, or take --network out"
        )
    _check_residuals(request, rig, network)
    if not (math.isfinite(request.start_s) and request.start_s >= 0.0):
        raise ConfigurationError(f"a virtual rig cannot start at {request.start_s} s of its time; give 0 s or more")
    if request.mode == "scaled" and not 0 < request.speed <= MOST_SPEED:
        raise ConfigurationError(
            f"--speed {request.speed:g} is not between 0 and {MOST_SPEED:g}; use --lockstep to go faster"
        )
    if request.mode != "real" and not request.virtual and request.control is None:
        raise ConfigurationError(f"{request.mode} time needs a rig whose time can be set; add --virtual")
    if request.effects is not None and not request.virtual:
        raise ConfigurationError(
            "--with switches on effects in the virtual rig; give --virtual too, or take --with out"
        )
    if request.virtual and not is_own_rig(rig):
        notes = [*notes, *_check_served(request, rig)]
    if request.effects is not None:
        notes = [*notes, *_check_effects(request.effects, profile, request.start_s)]
    if request.diagnose_s is not None:
        notes = [*notes, *_check_diagnosis(request, twin, network)]
    test = None
    if request.test is not None:
        twins = () if network is None or request.calibrators == () else _twins(request)
        test = prepared_test(request.test, rig, profile, network, twins)
    return RunInputs(rig, profile, twin, network, tuple(notes), test)


def _twins(request: RunRequest) -> tuple[str, ...]:
    """Return the names of the twins that run."""
    return (STATIC, *(DEFAULT if request.calibrators is None else request.calibrators))


def plant_twin(request: RunRequest, rig: Rig) -> Path | None:
    """Return the twin behind the devices of a rig file that --virtual serves; None where there is none."""
    return request.twin or rig.twin


def _check_served(request: RunRequest, rig: Rig) -> list[str]:
    """Return notes on a rig file whose devices --virtual serves; raises ConfigurationError."""
    if request.effects is not None:
        raise ConfigurationError(
            f"--with changes the built-in virtual rig, and {request.rig} describes another; take --with out, or "
            f"serve a twin that has the effect: hil rig {request.rig} --twin OTHER.toml --out served.toml"
        )
    twin = plant_twin(request, rig)
    if twin is None:
        return [f"{request.rig} is served without a twin: set-points appear at their read-backs, all other values rest"]
    return [f"{request.rig} is served with {twin} as its plant. {INVERSE_CRIME}"]


def _check_effects(file: Path, profile: Profile, start_s: float) -> list[str]:
    """Return notes on the effects of the virtual rig, which starts at `start_s`; raises EffectFileError."""
    from drivers.virtual.plant import load_effects

    return [
        f"{file}: effect {number} begins at {effect.onset_s:g} s, after the profile's end at {profile.duration_s:g} s"
        for number, effect in enumerate(load_effects(file), 1)
        if effect.onset_s >= start_s + profile.duration_s
    ]


def _check_residuals(request: RunRequest, rig: Rig, network: Network | None) -> None:
    """Raise ConfigurationError where an interlock watches a twin that does not run or has no such sensor."""
    for spec in rig.interlock:
        if not isinstance(spec, ResidualSpec):
            continue
        if network is None or request.calibrators == ():
            raise ConfigurationError(f"{request.rig}: an interlock watches a twin, and this run has none; name one")
        if spec.sensor not in network.sensor_names:
            known = ", ".join(network.sensor_names)
            raise ConfigurationError(f"{request.rig}: residual: the twin has no sensor {spec.sensor!r}; it has {known}")
        running = _twins(request)
        if spec.twin not in running:
            raise ConfigurationError(
                f"{request.rig}: residual: no twin {spec.twin!r} runs; there are {', '.join(running)}"
            )


def check_calibrators(names: tuple[str, ...] | None) -> None:
    """Raise ConfigurationError where one of the names is no calibrator, or stands twice."""
    from twin.calibrators import CALIBRATOR_NAMES

    unknown = [name for name in names or () if name not in CALIBRATOR_NAMES]
    if unknown:
        raise ConfigurationError(f"no calibrator {', '.join(unknown)}; there are {', '.join(CALIBRATOR_NAMES)}")
    twice = [name for name in dict.fromkeys(names or ()) if names is not None and names.count(name) > 1]
    if twice:
        raise ConfigurationError(f"--calibrator {twice[0]} is given twice; give each once")


def chosen_calibrators(
    calibrators: tuple[str, ...] | None, card: Path | None
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the calibrators that run, the usual ones for None, and those among them that may be left out.

    Raises
    ------
    ConfigurationError
        A card is given, and no calibrator uses a network.
    """
    from twin.calibrators import CALIBRATOR_NAMES, UNTRAINED_CALIBRATORS

    names = DEFAULT if calibrators is None else calibrators
    if card is not None and set(names) <= set(UNTRAINED_CALIBRATORS):
        asking = " or ".join(name for name in CALIBRATOR_NAMES if name not in UNTRAINED_CALIBRATORS)
        raise ConfigurationError(f"--network is given, and no calibrator uses it; add --calibrator {asking}")
    if calibrators is not None:
        return names, ()
    return names, tuple(name for name in DEFAULT[1:] if card is None or name in UNTRAINED_CALIBRATORS)


def _check_diagnosis(request: RunRequest, twin: Path | None, network: Network | None) -> list[str]:
    """Return notes on the diagnosis of the request; raises ConfigurationError or RecordError."""
    if network is None or twin is None:
        raise ConfigurationError("--diagnose needs a twin, and this run has none; take --no-twin out")
    from hil.diagnosis import commissioned_on, read_columns

    if request.healthy is not None:
        read_columns(network, request.healthy, None)
        return []
    kept = commissioned_on(twin)
    if kept.path is not None:
        return []
    none = "--diagnose without --healthy takes the noise floor from the run itself: small effects are not seen"
    return [kept.why, none] if kept.why else [none]


def setpoint_limits(rig: Rig) -> dict[str, SetpointLimit]:
    """Return the limits of set-points by profile column, in the units of their points."""
    limits = {}
    for column, point in setpoint_columns(rig).items():
        assert point.limits is not None
        low, high = point.limits
        own = point.as_signal().column
        limits[column] = SetpointLimit(low, high, max_rate_per_s=point.max_rate, unit=point.unit, setpoint=own)
    return limits


def _check_twin_columns(path: Path, network: Network, rig: Rig) -> list[str]:
    """Return notes on inputs of the twin that are not measured, so that a set-point replaces them.

    Raises
    ------
    ConfigurationError
        An input is neither measured nor a set-point, or a sensor is not measured.
    """
    measured = {point.as_signal().column for point in rig.point if point.is_polled}
    commanded = {point.as_signal().column for point in rig.setpoints} - measured
    inputs = set(network.recorded_inputs)
    sensors = set().union(*network.sensor_columns.values())
    missing = sorted((inputs - measured - commanded) | (sensors - measured))
    if missing:
        column = next((name for name in missing if name in inputs), None)
        named = "" if column is None else f", or call the set-point that stands for {column} as the twin's input"
        raise ConfigurationError(
            f"{path}: the twin needs {', '.join(missing)}, which the rig {rig.name} does not measure; "
            f"name a twin of this rig with --twin{named}"
        )
    return [
        f"{column} is not measured on {rig.name}: the twin takes the set-point, and does not see an actuator that fails"
        for column in network.input_columns
        if column in commanded
    ]


def tracking_config(request: RunRequest, ready: RunInputs, columns: tuple[str, ...]) -> TrackingConfig | None:
    """Return the configuration of the twins of the run, None without a twin; `columns` are those of the journal."""
    if ready.twin is None or request.calibrators == ():
        return None
    names, optional = chosen_calibrators(request.calibrators, request.card)
    return TrackingConfig(ready.twin, columns, names, request.seed, optional, card=request.card)
