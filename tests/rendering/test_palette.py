from marl_lanes.colours import TRAFFIC
from marl_lanes.rendering import palette
from marl_lanes.traffic.machine.state import Disposition, Outcome, Phase


def test_colours_are_those_of_the_shared_module():
    assert palette.to_rgb("#d42f22") == (0xD4, 0x2F, 0x22)
    assert palette.to_rgb(TRAFFIC.changer) == palette.CHANGER
    found = [palette.outline_of(disposition) for disposition in Disposition]
    names = [disposition.name.lower() for disposition in Disposition]
    assert found == [palette.to_rgb(getattr(TRAFFIC, name)) for name in names]


def test_mix_goes_from_one_colour_to_the_other():
    assert palette.mix((0, 100, 200), (100, 0, 200), 0.25) == (25, 75, 200)


def test_every_phase_and_outcome_has_a_colour():
    assert set(palette.PHASES) == set(Phase)
    assert set(palette.OUTCOMES) == set(Outcome) - {Outcome.UNFINISHED}
