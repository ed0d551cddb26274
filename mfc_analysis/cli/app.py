"""The command line: ``mfc-analysis``. Each command imports what it needs when it runs, so that ``--help`` is fast.

Exit codes: 0 success or requirements met, 1 a requirement is not met, 2 anything else (one sentence on standard error, never a traceback).
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any

import typer

from mfc_analysis.cli import terminal
from mfc_analysis.errors import BadArgument
from mfc_analysis.maths.threads import one_thread

app = typer.Typer(
    name="mfc-analysis",
    help="Stability, margins and gains of the control loops of a robot arm.",
    no_args_is_help=True,
    rich_markup_mode=None,  # plain help, in half the time
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

StudyFile = Annotated[Path, typer.Argument(metavar="STUDY", help="A study file (TOML), or the name of a shipped study: see 'studies'.")]


def main() -> None:
    """Runs the command line. Asked to end (SIGTERM) it leaves as after Ctrl-C, and takes its processes with it.

    Raises SystemExit with the exit code of the command: 0 met, 1 not met, 2 anything else, 128 + n after signal n.
    """
    import signal
    import sys

    one_thread()
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    terminal.open_streams()
    code: Any = terminal.BAD_INPUT
    try:
        app()
    except SystemExit as done:
        code = done.code
    except Exception as why:  # Python would end with 1, which says "not met"
        terminal.complain(f"error: {terminal.fault(why)}")
    sys.exit(code if terminal.flushed() else terminal.BAD_INPUT)


def _version(wanted: bool) -> None:
    if wanted:
        from mfc_analysis import __version__

        terminal.say(f"mfc-analysis {__version__}")
        raise typer.Exit


@app.callback()
def _options(version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")] = False) -> None:
    pass


# --- reports and checks --------------------------------------------------------------------------------------------------


@app.command()
@terminal.guarded
def report(
    study: Annotated[Path | None, typer.Argument(metavar="[STUDY]", help="A study file; default: the whole chapter on the embedded robots.")] = None,
    out: Annotated[Path, typer.Option(help="Output folder; nothing is written outside it.")] = Path("out"),
    format: Annotated[str, typer.Option(help="One or more of html, pdf, json, separated by commas.")] = "",
    full: Annotated[bool, typer.Option("--full", help="The chapter with a page for each arm and misprint, and all figures.")] = False,
) -> None:
    """Write a report: HTML, PDF and machine-readable JSON."""
    from mfc_analysis.report import study as study_report

    if full and study is not None:
        raise BadArgument("--full", str(study), "the report of the chapter, without a study")
    formats = _formats(format)
    with terminal.progress("report") as advance:
        files = study_report.chapter(out, formats, advance, full=full) if study is None else study_report.report(_study(study), out, formats, advance)
    terminal.say(*(str(path) for path in files))


@app.command()
@terminal.guarded
def schema(out: Annotated[Path | None, typer.Option(help="File to write; default: print it.")] = None) -> None:
    """Write the JSON schema of studies, for editors."""
    import json

    from mfc_analysis.maths import files
    from mfc_analysis.study.json_schema import json_schema

    text = json.dumps(json_schema(), indent=2)
    if out is None:
        terminal.say(text)
    else:
        files.write(out, f"{text}\n".encode())
        terminal.say(str(out))


@app.command()
@terminal.guarded
def check(
    study: StudyFile,
    allow_watch: Annotated[bool, typer.Option(help="Accept WATCH (requirements met, with a warning) as met.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    """Check a study's requirements. Exit code: 0 met, 1 not met, 2 bad input."""
    from mfc_analysis.study import check as study_check

    with terminal.progress("check") as advance:
        checks = study_check.check(_study(study), advance, search=True)
    if json:
        terminal.say(study_check.as_json(checks))
    else:
        for one in checks:
            terminal.table(study_check.COLUMNS, one.rows(), one.heading)
            terminal.say(*one.sentences())
    met = {"PASS", "WATCH"} if allow_watch else {"PASS"}
    if any(one.status not in met for one in checks):
        raise typer.Exit(terminal.NOT_MET)


@app.command()
@terminal.guarded
def limits(
    study: StudyFile,
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    """Find how far load, delay, bandwidth, sampling and wall may go.

    The requirements of the study are still met there. Exit code: 0 met as given, 1 not met, 2 bad input.
    """
    from mfc_analysis.cli import compare as compare_command
    from mfc_analysis.study import limits as study_limits

    with terminal.progress("limits") as advance:
        found = [study_limits.requirement_limits(one, advance) for one in _study(study).loops]
    if json:
        terminal.say(study_limits.as_json(found))
    else:
        for one in found:
            terminal.table(study_limits.COLUMNS, one.rows(), f"{one.loop.name}: {one.loop.requirements}")
            terminal.say(*one.sentences())
            compare_command.costs(f"{one.loop.name}: what each imperfection costs", one.costs)
    if not all(one.met for one in found):
        raise typer.Exit(terminal.NOT_MET)


@app.command()
@terminal.guarded
def compare(
    first: StudyFile,
    second: StudyFile,
    out: Annotated[Path | None, typer.Option(help="Folder for the pictures of the costs (SVG).")] = None,
) -> None:
    """Compare two studies.

    What changed, what it did to each requirement, and what each imperfection costs in both.
    """
    from mfc_analysis.cli import compare as compare_command

    with terminal.progress("compare") as advance:
        compare_command.run(_study(first), _study(second), out, advance)


@app.command()
@terminal.guarded
def init(
    robot: Annotated[str, typer.Argument(metavar="ROBOT", help="A URDF file, or a robot name: see 'mfc-analysis robots'.")],
    out: Annotated[Path | None, typer.Option(help="Study file to write; default: the robot's name with .toml, in this folder.")] = None,
    tool: Annotated[str | None, typer.Option(help="Tool link or frame; default: the last link. A URDF with a gripper needs it.")] = None,
    force: Annotated[bool, typer.Option(help="Overwrite an existing file.")] = False,
) -> None:
    """Write a commented study for a robot. It runs without changes."""
    from mfc_analysis.study import init as study_init

    written = study_init.write(robot, out, tool, overwrite=force)
    locked = tomllib.loads(written.read_text(encoding="utf-8"))["robot"].get("locked", ())
    said = (f"locked at 0: {', '.join(locked)}",) if locked else ()
    terminal.say(f"{written}", *said, f"next: mfc-analysis check {written}")


@app.command()
@terminal.guarded
def export(
    study: StudyFile,
    to: Annotated[str, typer.Option(help="Where the gains go: ros2_control.")] = "ros2_control",
    source: Annotated[Path | None, typer.Option("--from", help="Instead: read the gains of this parameter file into the study.")] = None,
    controller: Annotated[str, typer.Option(help="joint_trajectory_controller or pid_controller.")] = "joint_trajectory_controller",
    name: Annotated[str, typer.Option(help="Name of the controller in the file; default: that of its type.")] = "",
    out: Annotated[Path | None, typer.Option(help="File to write; the other lines of a parameter file that exists stay. Default: print it.")] = None,
) -> None:
    """Write gains for the controller on the arm, in its units.

    Or read them from its parameter file into a study.
    """
    from mfc_analysis.cli import export as export_command

    if source is None:
        made = export_command.to_controller(study, to, controller, name, out)
        text, notes = made.text, made.notes
    else:
        text, notes = export_command.from_controller(study, source, name, out)
    terminal.say(*([text.rstrip("\n")] if out is None else [out]))
    for note in notes:
        terminal.complain(f"note: {note}")


@app.command()
@terminal.guarded
def studies(
    copy: Annotated[Path | None, typer.Option(help="Copy the studies into this folder as a starting point.")] = None,
    keys: Annotated[bool, typer.Option("--keys", help="List all tables that a study can have, with their keys.")] = False,
) -> None:
    """List the studies shipped with the package."""
    from mfc_analysis.study.shipped import copied, shipped

    if keys:
        from mfc_analysis.study.read import keys as tables

        terminal.pairs([(name, ", ".join(takes)) for name, takes in tables().items()])
        return
    if copy is not None:
        terminal.say(*(str(path) for path in copied(copy)))
        return
    terminal.pairs([(name, title) for name, (_, title) in shipped().items()])


@app.command()
@terminal.guarded
def frf(
    file: Annotated[Path, typer.Argument(metavar="CSV", help="Measured signals, a column each, with their names in the first line.")],
    time: Annotated[str, typer.Option(help="Column of the time, in s.")] = "t",
    input: Annotated[str, typer.Option(help="Column of the signal after the excitation, or a sum of columns such as 'tau + r'.")] = "u",
    output: Annotated[str, typer.Option(help="Column of minus the signal before the excitation: '--output=-tau'.")] = "y",
    excitation: Annotated[str | None, typer.Option(help="Column of the excitation; needed where the loop was closed.")] = None,
    period: Annotated[float | None, typer.Option(help="Period of a periodic excitation, in s.")] = None,
    averages: Annotated[int, typer.Option(help="Segments to average, at least.")] = 8,
    study: Annotated[Path | None, typer.Option(help="Compare with the first loop of this study.")] = None,
    at: Annotated[str | None, typer.Option(help="Analysis point; default: that of the study.")] = None,
    channel: Annotated[str | None, typer.Option(help="Joint; default: the first.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw the figure into this file (SVG).")] = None,
) -> None:
    """Estimate a loop's frequency response from measured signals.

    With a study, the measured loop is compared with that of the model.
    """
    from mfc_analysis.cli import measured

    columns = {"time": time, "input": input, "output": output, "excitation": excitation}
    found, over = measured.response(file, columns, period, averages, None if study is None else _study(study), at, channel)
    terminal.say(found)
    if over is None:
        terminal.table(measured.COLUMNS, found.rows())
    else:
        terminal.say(over)
    if plot is not None:
        terminal.say(measured.drawn(over or found, plot))


def _study(path: Path) -> Any:
    from mfc_analysis import study
    from mfc_analysis.study.shipped import found

    return study.read(found(path))


def _formats(text: str) -> tuple[str, ...]:
    known = ("html", "pdf", "json")
    formats = tuple(word.strip().lower() for word in text.split(",") if word.strip())
    for word in formats:
        if word not in known:
            raise BadArgument("--format", word, "some of html, pdf, json, separated by commas")
    return formats


# --- design helpers ------------------------------------------------------------------------------------------------------


@app.command()
@terminal.guarded
def gains(
    kind: Annotated[str, typer.Argument(help="p, pi, pd, pid, joint-pid, force-pi, cartesian-damping, impedance or admittance.")],
    bandwidth_hz: Annotated[float | None, typer.Option(help="Frequency at which T = L/(1 + L) falls to -3 dB, in Hz.")] = None,
    bandwidth: Annotated[float | None, typer.Option(help="As above, in rad/s.")] = None,
    natural_frequency_hz: Annotated[float | None, typer.Option(help="Natural frequency of the dominant poles, in Hz.")] = None,
    natural_frequency: Annotated[float | None, typer.Option(help="As above, in rad/s.")] = None,
    crossover_hz: Annotated[float | None, typer.Option(help="Frequency at which |L| = 1, in Hz.")] = None,
    crossover: Annotated[float | None, typer.Option(help="As above, in rad/s.")] = None,
    settling_time: Annotated[float | None, typer.Option(help="Settling time to 2 % of the step named by --step, in s.")] = None,
    step: Annotated[
        str | None, typer.Option(help="reference: a step of q_d with v_d = 0 (force-pi: of F_d); loop: of T. Default: reference.")
    ] = None,
    damping: Annotated[float | None, typer.Option(help="Damping ratio of the dominant pole pair; default: 1.")] = None,
    inertia: Annotated[str | None, typer.Option(help="Inertia: one or more numbers separated by commas, in kg m^2 or kg; default: 1.")] = None,
    robot: Annotated[
        str | None, typer.Option(help="joint-pid, cartesian-damping, impedance: a URDF file, a study, or a robot name (see 'robots').")
    ] = None,
    tool: Annotated[str | None, typer.Option(help="Tool frame of the robot.")] = None,
    q: Annotated[
        str | None, typer.Option(help="Joint positions separated by commas, in rad or m; default: all 0, or the start of the study.")
    ] = None,
    stiffness: Annotated[
        str | None, typer.Option(help="force-pi, admittance: of the surface, in N/m; cartesian-damping, impedance: one or six numbers.")
    ] = None,
    mass: Annotated[float | None, typer.Option(help="force-pi: moving mass, in kg.")] = None,
    lag: Annotated[float | None, typer.Option(help="force-pi, admittance: lag of the torque or velocity, in s.")] = None,
    torque_lag: Annotated[float | None, typer.Option(help="joint-pid: lag of each torque in the coupled loop, in s.")] = None,
    delay: Annotated[
        float | None, typer.Option(help="joint-pid: dead time of each torque in the coupled loop; admittance: all dead time of the loop; in s.")
    ] = None,
    friction: Annotated[float | None, typer.Option(help="force-pi: friction of the moving mass, in N s/m.")] = None,
    ratio: Annotated[float | None, typer.Option(help="cartesian-damping, impedance: damping ratio of each mode; default: 1.")] = None,
    servo_hz: Annotated[float | None, typer.Option(help="admittance: -3 dB bandwidth of the arm's own servo, in Hz.")] = None,
    servo: Annotated[float | None, typer.Option(help="As above, in rad/s.")] = None,
    servo_damping: Annotated[float | None, typer.Option(help="admittance: damping ratio of the servo; default: 0.7071.")] = None,
) -> None:
    """Compute gains for a bandwidth, crossover or settling time. Prints the formula and the metrics achieved."""
    from mfc_analysis.cli import gains as gains_command

    given = {name: value for name, value in locals().items() if value is not None and name not in ("kind", "gains_command")}
    terminal.say(str(gains_command.designed(kind, given)))


# --- exercises -----------------------------------------------------------------------------------------------------------


@app.command()
@terminal.guarded
def exercise(
    number: Annotated[str, typer.Argument(help="9.1, 9.2, 9.3 or 9.4.")],
    target_deg: Annotated[float | None, typer.Option(help="9.1-9.3: target angle of the link, in degrees.")] = None,
    kp: Annotated[float | None, typer.Option(help="Proportional gain (9.1: N m/rad; 9.2, 9.3: 1/s^2).")] = None,
    ki: Annotated[float | None, typer.Option(help="Integral gain (9.1: N m/(rad s); 9.2, 9.3: 1/s^3).")] = None,
    kd: Annotated[float | None, typer.Option(help="Derivative gain (9.1: N m s/rad; 9.2, 9.3: 1/s).")] = None,
    velocity_deg: Annotated[float | None, typer.Option(help="9.2, 9.3: maximum velocity of the motion, in degrees/s; 0: a step.")] = None,
    duration: Annotated[float, typer.Option(help="9.1-9.3: simulated time after the motion, in s.")] = 5.0,
    inertia: Annotated[float, typer.Option(help="9.1-9.3: inertia of the link about its joint, in kg m^2.")] = 0.5,
    mass: Annotated[float, typer.Option(help="9.1-9.3: mass of the link, in kg.")] = 1.0,
    com_distance: Annotated[float, typer.Option(help="9.1-9.3: distance of the centre of mass from the joint, in m.")] = 0.1,
    damping: Annotated[float, typer.Option(help="9.1-9.3: viscous friction of the joint, in N m s/rad.")] = 0.1,
    theta_deg: Annotated[float | None, typer.Option(help="9.4: angle of the revolute joint, in degrees.")] = None,
    d: Annotated[float | None, typer.Option(help="9.4: length of the prismatic joint, in m.")] = None,
    fx: Annotated[float | None, typer.Option(help="9.4: force along x of the base, in N.")] = None,
    fy: Annotated[float | None, typer.Option(help="9.4: force along y of the base, in N.")] = None,
    out: Annotated[Path | None, typer.Option(help="9.1-9.3: folder for the graph of position, velocity and torque (SVG).")] = None,
) -> None:
    """Run a practice question of the chapter. Missing options are prompted for on a terminal; otherwise they take their defaults."""
    from mfc_analysis.cli import exercise as exercise_command

    answers = {"target_deg": target_deg, "kp": kp, "ki": ki, "kd": kd, "velocity_deg": velocity_deg}
    answers |= {"theta_deg": theta_deg, "d": d, "fx": fx, "fy": fy}
    link = {"inertia": inertia, "mass": mass, "com_distance": com_distance, "damping": damping}
    exercise_command.run(number, {key: value for key, value in answers.items() if value is not None}, link, duration, out)


# --- lists ---------------------------------------------------------------------------------------------------------------


@app.command()
@terminal.guarded
def laws() -> None:
    """List the control laws, by equation."""
    from mfc_analysis.laws import LAWS

    rows = []
    for number, law in LAWS.items():
        takes = ", ".join(law.parameters())
        said = (law.__doc__ or "").strip().splitlines()[0].split(":")[0]
        rows.append((number, law.__name__, said, takes or "-", ", ".join(law.opens_at)))
    terminal.table(("equation", "law", "what", "takes", "opens at"), rows)


def _first_line(docstring: str | None) -> str:
    """The first line of a docstring, without the formula and the reStructuredText markup."""
    return (docstring or "").strip().splitlines()[0].partition(": :math:")[0].replace("``", "").rstrip(".")


@app.command()
@terminal.guarded
def robots() -> None:
    """List the embedded robots, and the arms of example-robot-data."""
    from mfc_analysis.robots.catalogue import EMBEDDED, names

    rows = []
    for name, build in EMBEDDED.items():
        robot = build()
        rows.append((name, "embedded", str(robot.n), robot.tool, _first_line(build.__doc__)))
    arms = tuple(name for name in names() if name not in EMBEDDED or name == "ur5")
    rows += [(name, "load", "", "", "example-robot-data") for name in arms]
    terminal.table(("name", "from", "joints", "tool", "what"), rows)
