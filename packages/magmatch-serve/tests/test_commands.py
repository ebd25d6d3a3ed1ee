# SPDX-License-Identifier: BSD-3-Clause
"""What this distribution adds to the program: `serve` and `replay`, as commands of it like any other."""

import subprocess
import sys

import numpy as np
import pytest

from magmatch.cli.main import main
from magmatch_serve.replay import Replayed


@pytest.mark.parametrize("name", ["serve", "replay"])
def test_help_of_a_command_has_examples(name, capfd):
    assert main([name, "--help"]) == 0
    said = capfd.readouterr().out
    assert "Examples:" in said
    assert f"  magmatch {name} " in said


def test_help_does_not_wait_for_a_server():
    code = (
        "import sys; from magmatch.cli.main import main; main(['serve', '--help'])\n"
        "print(sorted({'numba', 'starlette', 'uvicorn', 'websockets'} & set(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"


def test_replay_sends_the_log_as_its_options_say(tmp_path, monkeypatch, capfd):
    log, sent = tmp_path / "walk.csv", []
    rows = [f"{t},{1000 * t},0,0,0,0,0,1,18,3,-45\n" for t in range(30)]
    log.write_text("t,x,y,z,qx,qy,qz,qw,bx,by,bz\n" + "".join(rows))

    def take(survey, *_, on_pose, **__):
        sent.append(survey)
        on_pose({"status": "searching", "t": 29.0, "reason": "no place fits: z is not up (--no-gravity)"})
        return Replayed(np.empty(0), None, 1, 0)

    monkeypatch.setattr("magmatch_serve.replay.replay", take)
    words = ["replay", str(log), "--url", "http://127.0.0.1:1", "--field-unit", "uT", "--length-unit", "mm"]
    assert main(words) == 3  # no pose came back
    assert "1 answers, 0 with a pose: no place fits: z is not up (--no-gravity)\n" in capfd.readouterr().err
    np.testing.assert_allclose(sent[0].field, np.tile([18e-6, 3e-6, -45e-6], (30, 1)))
    np.testing.assert_allclose(sent[0].positions[-1], [29.0, 0.0, 0.0])
