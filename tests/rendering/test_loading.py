import subprocess
import sys

LOAD = "from marl_lanes.rendering.loading import pygame"


def run(source):
    return subprocess.run([sys.executable, "-c", source], capture_output=True, text=True)


def test_pygame_is_loaded_without_a_greeting_and_without_a_display():
    done = run(f"{LOAD}; assert pygame.display.get_init() is False")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_without_pygame_the_error_names_the_extra():
    done = run(f"import sys; sys.modules['pygame'] = None; {LOAD}")
    assert done.returncode == 1
    last = done.stderr.strip().splitlines()[-1]
    assert last.endswith("pygame: is not installed: pip install 'marl-lanes[view]'")


def test_the_other_pygame_is_refused():
    fake = "import sys, types; sys.modules['pygame'] = types.ModuleType('pygame')"
    done = run(f"{fake}; {LOAD}")
    assert done.returncode == 1
    assert "pygame: pygame-ce is needed, and pygame is in its place" in done.stderr
