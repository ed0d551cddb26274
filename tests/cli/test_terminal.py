"""What the command line shows: text without markup, tables, a bar on a terminal only, errors and warnings as a line each."""

from __future__ import annotations

import io
import warnings

import pytest
from typer import Abort, Exit

from mfc_analysis.cli import terminal
from mfc_analysis.cli.terminal import BAD_INPUT, guarded, plain
from mfc_analysis.errors import BadArgument, MfcWarning
from tests.cli.commands import run, small


class Screen(io.StringIO):
    """A stream that is a terminal."""

    def isatty(self) -> bool:
        return True


def test_no_progress_bar_without_a_terminal(tmp_path):
    done = run("check", small(tmp_path, 10.0, "[ranges]\ntorque_lag = [0.0, 0.01]\n"))
    assert done.stderr == "" and "\x1b" not in done.stdout


def test_what_does_not_print_is_spelt_out(tmp_path):
    assert plain("a\x1b[31mb\x07\nc é ≥") == "a\\x1b[31mb\\x07\nc é ≥"
    done = run("check", small(tmp_path, 10.0, '[[loop]]\nname = "\\u001b[31mred [bold]x[/bold]"\n'))
    assert "\x1b" not in done.stdout and "\\x1b[31mred [bold]x[/bold]" in done.stdout


def test_warnings_are_a_line_each_on_the_standard_error(tmp_path):
    path = small(tmp_path)
    path.write_text(path.read_text().replace('name = "single_joint"', 'name = "single_joint"\nparameters = { inertia = 0.005 }'))
    done = run("check", path)
    assert done.stderr.count("warning: inertia=0.005") == 1 and ".py" not in done.stderr


def test_pairs_stand_in_two_columns(capsys):
    terminal.pairs([("kp", "80"), ("desired location [deg]", "45")])
    first, second = capsys.readouterr().out.splitlines()
    assert first.index("80") == second.index("45") == len("desired location [deg]") + 2


def test_a_table_leaves_out_empty_columns_and_takes_no_markup(capsys):
    terminal.table(("result", "case", "found"), [("PASS", "", "1"), ("FAIL", "", "[bold]2[/bold]")], title="[red]loop[/red]")
    said = capsys.readouterr().out
    assert "case" not in said and "[bold]2[/bold]" in said and said.startswith("[red]loop[/red]\n")
    assert "\x1b" not in said and all(line == line.rstrip() for line in said.splitlines())
    terminal.table(("result", "case"), [("PASS", ""), ("FAIL", "mass = 2")])
    assert "case" in capsys.readouterr().out


def test_a_bar_is_drawn_on_a_terminal_with_the_words_as_they_are(monkeypatch):
    screen = Screen()
    monkeypatch.setattr("sys.stderr", screen)
    monkeypatch.setenv("TERM", "xterm")
    with terminal.progress("the [bold]study[/bold]") as advance:
        advance("loop \x1b[2J", 3, 4)
    drawn = screen.getvalue()
    assert "the [bold]study[/bold]" in drawn and "3/4" in drawn
    assert "loop \\x1b[2J" in drawn and "\x1b[2J" not in drawn


def test_without_a_terminal_progress_says_nothing(capsys):
    with terminal.progress("study") as advance:
        advance("loop", 1, 2)
    assert capsys.readouterr() == ("", "")


# --- guarded -----------------------------------------------------------------------------------------------------------------


def ends(error: BaseException) -> int:
    """Exit code of a command that raises this."""

    @guarded
    def command() -> None:
        raise error

    with pytest.raises(Exit) as done:
        command()
    return int(done.value.exit_code)


def test_an_error_of_the_package_is_a_sentence_and_exit_code_2(capsys):
    assert ends(BadArgument("--kp", "\x1bx", "a number")) == BAD_INPUT
    assert capsys.readouterr().err == "error: --kp: got '\\x1bx'; takes a number\n"


def test_a_file_that_cannot_be_used_is_named(capsys):
    assert ends(PermissionError(13, "Permission denied", "out/page.html")) == BAD_INPUT
    assert capsys.readouterr().err == "error: out/page.html: Permission denied\n"


@pytest.mark.parametrize(("error", "code"), [(MemoryError(), BAD_INPUT), (Abort(), BAD_INPUT), (KeyboardInterrupt(), 130)])
def test_what_is_no_verdict_never_ends_with_1(error, code):
    assert ends(error) == code


def test_an_error_of_our_own_is_not_hidden():
    @guarded
    def command() -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        command()


def test_each_warning_of_the_package_is_said_once_and_those_of_others_not_at_all(capsys):
    @guarded
    def command(times: int, *, word: str) -> None:
        for _ in range(times):
            warnings.warn(word, MfcWarning, stacklevel=1)
        warnings.warn("of another library", DeprecationWarning, stacklevel=1)

    command(3, word="the arm is light")
    assert capsys.readouterr().err == "warning: the arm is light\n"
    assert command.__name__ == "command"
