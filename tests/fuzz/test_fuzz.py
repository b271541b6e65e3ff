"""Whatever anyone writes: no file, override, argument or folder ends in a traceback, a hang or an unclear message."""

import cases
import pytest
import run

SEED = 0


@pytest.mark.exhaustive
def test_random_input_is_refused_clearly_or_done_right(tmp_path):
    # In a process of its own: checks of types make what is timed several times as long.
    found = run.fuzz(SEED, range(60), 1, str(tmp_path))
    # What takes long is for `make fuzz` to say: how long depends on the machine.
    kept = {number: [fault for fault in faults if not fault.startswith("took ")] for number, faults in found.items()}
    said = [f"{'; '.join(faults)}\n{run.show(cases.make(SEED, number))}" for number, faults in kept.items() if faults]
    assert not said, "\n\n".join(said)


def test_a_case_depends_on_seed_and_number_alone():
    assert cases.make(3, 7) == cases.make(3, 7) != cases.make(4, 7)


@pytest.mark.parametrize(
    ("said", "fault"),
    [
        ("a.yaml:3: filter.radius: is x; expected a number; give one", ""),
        ("a.yaml:3: is not YAML: found a tab (column 2); indent with spaces", ""),
        ("override 'seed=x': seed: is 'x'; expected a whole number; give one", ""),
        ("override 'seed': is not KEY=VALUE; expected a dotted key; write it so", ""),
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
        run.signal.raise_signal(run.signal.SIGPROF)

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
