"""Latency of the viewer without a browser: of the first picture, and of the preview of one step of a drag."""

import json
import subprocess
import sys
import time
from pathlib import Path
from statistics import median

from tests.obpose.viewer.driving import free_port

GOAL_FIRST, GOAL_PREVIEW = 5.0, 0.5
STEPS = 8

# A separate process, because imports are part of the latency.
CHILD = """
import json, sys, threading, time
from pathlib import Path
import torch
from obpose.commands.view import Arguments, serve
from obpose.viewer.panel import Panel
from obpose.viewer.session import Session

shown, show_picture = threading.Event(), Panel.show_picture

def show_and_signal(panel, image, observed):
    show_picture(panel, image, observed)
    shown.set()

Panel.show_picture = show_and_signal
page = serve(Arguments(Path(sys.argv[1]), port=int(sys.argv[2])))
shown.wait()
first = time.process_time(), time.monotonic() - float(sys.argv[4])
page.worker.wait(120.0)
session = page.session
page.edit(lambda session: session.select(session.scene.ids[0]))
at = session.scene.center[0, 0].clone()
page.edit(Session.grab)
steps = []
for step in range(int(sys.argv[3])):
    shown.clear()
    begin, clock = time.process_time(), time.monotonic()
    at[0] += 0.01
    page.edit(lambda session: session.drag(at, torch.eye(3)))
    shown.wait()
    steps.append((time.process_time() - begin, time.monotonic() - clock))
    page.worker.wait(120.0)
page.close()
print(json.dumps([len(session.scene.ids), first, steps]))
"""


def test_the_first_picture_and_those_of_a_drag_are_there_in_time(tiny_dataset: Path):
    command = [sys.executable, "-c", CHILD, str(tiny_dataset), str(free_port()), str(STEPS), str(time.monotonic())]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    objects, first, steps = json.loads(done.stdout.splitlines()[-1])
    cpu, wall = (median(values) for values in zip(*steps, strict=True))
    print(
        f"\n64x64, {objects} objects: first picture after {first[0]:.2f} s of CPU time (goal {GOAL_FIRST:g}), "
        f"{first[1]:.1f} s by the clock; preview of an edit after {cpu:.2f} s of CPU time (goal {GOAL_PREVIEW:g}), "
        f"{wall:.2f} s by the clock"
    )
    assert first[0] <= GOAL_FIRST
    assert cpu <= GOAL_PREVIEW
