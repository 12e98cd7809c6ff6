import pytest

from service.cli import output


def test_where_no_bar_can_be_drawn_a_line_says_how_far_the_work_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = [100.0]
    monkeypatch.setattr(output, "monotonic", lambda: now_s[0])
    with output.progress() as bar:
        task = bar.add_task("mining", total=None)
        bar.update(task, completed=1, total=20)
        now_s[0] += output.LINE_EVERY_S
        bar.update(task, completed=7, total=20)
        bar.update(task, completed=8, total=20)
    assert capsys.readouterr().err == "mining: 7 of 20\n"
