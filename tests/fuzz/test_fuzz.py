"""Whatever anyone writes: no file, override, argument or folder ends in a traceback, a hang or an unclear message."""

import cases
import pytest
import run
from scenes import staying_in

import diffshadow.cli

SEED, CASES, AT_ONCE = 0, 300, 50


@pytest.fixture(scope="module", autouse=True)
def apart(tmp_path_factory):
    """A folder for the cases, with a finished run."""
    with staying_in(tmp_path_factory.mktemp("fuzz")), pytest.MonkeyPatch.context() as patch:
        # What the tests compile is kept elsewhere already.
        patch.setattr(diffshadow.cli, "_keep_compiled_programs", lambda: None)
        run.make_template()
        yield


@pytest.mark.parametrize("first", range(0, CASES, AT_ONCE))
def test_random_input_is_refused_clearly_or_done_right(first):
    found = {}
    for number in range(first, first + AT_ONCE):
        case = cases.make(SEED, number)
        if faults := run.run_case(case):
            found[run.show(case)] = faults
    assert not found, "\n".join(f"{'; '.join(faults)}\n{shown}" for shown, faults in found.items())


def test_a_case_depends_on_seed_and_number_alone():
    assert cases.make(3, 7) == cases.make(3, 7) != cases.make(4, 7)


@pytest.mark.parametrize(
    ("said", "fault"),
    [
        ("a.yaml:3: filter.radius: is x; expected a number; give one", ""),
        ("a.yaml:3: is not YAML: found a tab (column 2); indent with spaces", ""),
        ("override 'seed=x': seed: is 'x'; expected a whole number; give one", ""),
        ("override 'seed': is no KEY=VALUE; expected a dotted key; write it so", ""),
        ("a.yaml: seed: is 'x'; expected a whole number; give one", "no place"),
        ("seed: is 'x'; expected a whole number; give one", "no place"),
        ("a.yaml:3: is 'x'; expected a whole number: give one", "no key"),
        ("a.yaml:3: scene.meshes.0: division by zero", "not said what was expected"),
    ],
)
def test_an_unclear_message_is_a_fault(said, fault):
    assert run.wrong_with_line(said) == fault


def test_a_crash_a_warning_and_a_raw_control_character_are_faults(monkeypatch):
    def told(work):
        monkeypatch.setattr(run, "command", work)
        return [*run.faults_of(cases.make(0, 1), ["validate"], run.call(["validate"]))]

    def warns(_):
        run.warnings.warn("overflow", RuntimeWarning, stacklevel=1)
        raise SystemExit(0)

    def hangs(_):
        run.signal.raise_signal(run.signal.SIGALRM)

    def says(text, code):
        def work(_):
            print(text, file=run.sys.stderr)
            raise SystemExit(code)

        return work

    good = "error: a.yaml:1: seed: is 'x'; expected a whole number; give one"
    assert told(says(good, 2)) == []
    assert told(says(good, 1)) == ["exit 1"]
    assert "U+001B" in told(says(f"{good} \x1b[1m", 2))[0]
    assert "no place" in told(says(f"{good}\nand more", 2))[0]
    assert "success" in told(says("by the way", 0))[0]
    assert "ZeroDivisionError" in told(lambda _: 1 / 0)[0]
    assert "RuntimeWarning" in told(warns)[0]
    assert "stopped" in told(hangs)[0]
