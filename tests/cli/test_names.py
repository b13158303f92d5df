"""Labels of lane changers and followers."""

import pytest

from marl_lanes.cli.names import label_changers, label_followers


@pytest.mark.parametrize(
    ("entries", "labels"),
    [
        (["runs/a/checkpoints/final.pt", "runs/b/checkpoints/final.pt"], ["a", "b"]),
        (["x/runs/a/checkpoints/final.pt", "y/runs/a/checkpoints/final.pt", "c.pt"],
         ["x/runs/a", "y/runs/a", "c"]),
        (["runs/a/checkpoints/step_1.pt", "runs/a/checkpoints/step_2.pt"],
         ["a/step_1", "a/step_2"]),
        (["runs/a/checkpoints/final.pt", "runs/a/checkpoints/step_2.pt"], ["a", "a/step_2"]),
        (["one/policy.pt", "two/policy.pt"], ["one/policy", "two/policy"]),
        (["/r/one/policy.pt", "policy.pt"], ["one/policy", "policy"]),
        (["random", "x/random.pt"], ["random", "x/random"]),
        (["p.pt", "p.pt@settled", "p.pt@my/settled.yaml"],
         ["p", "p.pt@settled", "p.pt@my/settled.yaml"]),
    ],
)  # fmt: skip
def test_every_changer_has_a_name_of_its_own(entries, labels):
    found = label_changers(entries)
    assert len(found) == len(entries)
    assert list(found) == labels


def test_a_name_that_is_no_text_can_be_drawn():
    assert list(label_changers(["\udcff.pt", "r\xe4um.pt"])) == ["\\udcff", "r\xe4um"]


def test_a_changer_may_name_its_scenario():
    found = label_changers(["random", "a/b.pt@my/weak.yaml"])
    assert found == {"random": ("random", None), "b@weak": ("a/b.pt", "my/weak.yaml")}


def test_the_path_of_a_checkpoint_may_contain_an_at_sign(tmp_path):
    file = tmp_path / "b@paper.pt"
    file.touch()
    assert label_changers([str(file)]) == {"b@paper": (str(file), None)}


def test_a_follower_is_a_mix_of_one_kind():
    paths = ["runs/a/checkpoints/final.pt", "runs/b/checkpoints/final.pt"]
    found = label_followers(["neutral", *(f"learned:{path}" for path in paths)])
    assert list(found) == ["neutral", "learned:a", "learned:b"]
    assert found["neutral"] == {"mix": {"neutral": 1.0}}
    for label, path in zip(["learned:a", "learned:b"], paths, strict=True):
        assert found[label] == {"mix": {"learned": 1.0}, "learned": {"checkpoint": path}}


@pytest.mark.parametrize(
    ("label", "entries", "message"),
    [
        (label_changers, ["b.pt", "b.pt"], "--changers b.pt: must be given once"),
        (label_changers, ["b.pt@"], "--changers b.pt@: must be CHANGER or CHANGER@SCENARIO"),
        (label_changers, ["@paper"], "--changers @paper: must be CHANGER or CHANGER@SCENARIO"),
        (label_followers, ["x", "x"], "--followers x: must be given once"),
        (label_followers, ["a:b"], "--followers a:b: must be a name, or learned:CHECKPOINT"),
        (label_followers, ["learned:"], "--followers learned:: must be a name, or learned:"),
    ],
)
def test_other_entries_are_refused(label, entries, message):
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        label(entries)
    assert str(caught.value).startswith(message)
