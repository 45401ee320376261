"""Films a lesson: `python -m docs.filming FILE.gif`, the cart-pole taught by the scripted teacher of the tests.

The page of `gpcjax teach` in Chromium, as it is; a picture each 0.2 s of the first seconds.
"""

import io
import itertools
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

APART, SECONDS, WIDTH, COLOURS = 0.2, 11.0, 720, 200
TEACHER = Path(__file__).parents[1] / "tests" / "teach" / "teacher.js"


def film(target: Path, env: str = "cartpole", chromium: str = "/usr/bin/chromium") -> None:
    """Writes the film of one lesson."""
    pictures: list[tuple[float, Image.Image]] = []
    with tempfile.TemporaryDirectory() as scratch, sync_playwright() as playwright:
        words = ["teach", "--env", env, "--out", f"{scratch}/taught", "--port", "0"]
        server = subprocess.Popen([sys.executable, "-m", "gpcjax", *words], stdout=subprocess.PIPE, text=True)
        assert server.stdout is not None
        page = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"]).new_page(
            viewport={"width": 1180, "height": 790}
        )
        page.goto(server.stdout.readline().split()[1])
        while page.evaluate("document.documentElement.dataset.phase") != "waiting":
            time.sleep(0.2)
        time.sleep(8.0)  # until the lines of expert and idle are there
        page.keyboard.press("Space")
        page.evaluate(TEACHER.read_text(), env)
        began = time.monotonic()
        while (now := time.monotonic() - began) < SECONDS:
            pictures.append((now, Image.open(io.BytesIO(page.screenshot()))))
            time.sleep(max(0.0, began + APART * len(pictures) - time.monotonic()))
        server.send_signal(signal.SIGINT)
        server.wait()
    small = [
        picture.convert("RGB").resize(
            (WIDTH, round(WIDTH * picture.height / picture.width)), Image.Resampling.LANCZOS
        )
        for _, picture in pictures
    ]
    some = small[:: max(1, len(small) // 8)]
    # What is lit now and then is small: its colours come into the palette by showing it alone.
    some += [picture.crop((0, int(0.83 * picture.height), WIDTH, picture.height)) for picture in small[::2]]
    all_of_them = Image.new("RGB", (WIDTH, sum(picture.height for picture in some)))
    at = 0
    for picture in some:
        all_of_them.paste(picture, (0, at))
        at += picture.height
    palette = all_of_them.quantize(COLOURS)
    frames = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in small]
    times = [when for when, _ in pictures] + [SECONDS + 1.0]
    shown = [round(1000 * (after - at)) for at, after in itertools.pairwise(times)]
    frames[0].save(target, save_all=True, append_images=frames[1:], duration=shown, loop=0, optimize=True)


if __name__ == "__main__":
    film(Path(sys.argv[1]))
