import fractions
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxcslc._environment import require
from sim.engine._truth import Truth
from sim.machine._bodies import MachineError
from sim.machine._loads import Load
from sim.machine._machine import Machine
from sim.recording._scene import Scene, holding


_LINE = 22  # height of a line of text [pixels]
_INK = (30, 30, 30)


def film(
    path: Path | str,
    machine: Machine,
    truths: Truth | Sequence[Truth],
    *,
    loads: Sequence[Load] = (),
    titles: Sequence[str] = (),
    caption: Callable[[int, int], str] | None = None,
    speed: float = 1.0,
    rate: int = 25,
    size: tuple[int, int] = (640, 480),
    view: tuple[float, float] = (135.0, -20.0),
    floor: float | None = None,
) -> None:
    """Makes a film of a motion, or of several side by side.

    Rods are drawn from joint to joint. A load is drawn as a box, before and after it is carried
    at the position where it is picked up or put down. Needs PyAV and Pillow, and OpenGL without a
    screen: set `MUJOCO_GL=egl` (or `osmesa`) in the environment before MuJoCo is loaded.

    **Arguments**

    - `path`: of the film, an `.mp4` file.
    - `machine`: the machine to draw.
    - `truths`: the motion of the machine, or several of as many samples.
    - `loads`: the loads of the trajectory.
    - `titles`: one a motion.
    - `caption`: returns the text below a motion, from the numbers of motion and sample, both
        counted from 0.
    - `speed`: of the film; 2 for twice as fast as the motion.
    - `rate`: pictures a second.
    - `size`: of a motion's picture: width and height, even numbers [pixels].
    - `view`: azimuth and elevation of the camera [degrees].
    - `floor`: its height in frame 0 [m]; see `Scene.of`.

    **Raises**

    - `ImportError`: PyAV or Pillow is missing, with the command that installs them.
    - `MachineError`: OpenGL is missing; truths, titles or numbers that do not fit.

    >>> import sim
    >>> _, truth = sim.simulate(sim.puma560(), sim.training(samples=50))
    >>> sim.film("build/arm.gif", sim.puma560(), truth)
    Traceback (most recent call last):
    ...
    sim.machine._bodies.MachineError: film: build/arm.gif; expected a name that ends in .mp4
    """
    path = Path(path)
    motions = [truths] if isinstance(truths, Truth) else list(truths)
    _check(path, motions, titles, speed, rate, size)
    av = require("av", "film")
    require("PIL", "film")
    pictures = Pictures(machine, motions, loads, titles, caption, size, view, floor)
    time = motions[0].time
    count = math.floor((time[-1] - time[0]) / speed * rate) + 1
    shown = np.searchsorted(time, time[0] + np.arange(count) * speed / rate - 1e-9)
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with av.open(str(path), "w") as container:
            stream = container.add_stream("libx264", rate=fractions.Fraction(rate))
            stream.width, stream.height = pictures.width, pictures.height
            stream.pix_fmt = "yuv420p"
            stream.options = {"crf": "20"}
            for sample in np.minimum(shown, time.size - 1):
                frame = av.VideoFrame.from_ndarray(pictures.at(int(sample)), format="rgb24")
                container.mux(stream.encode(frame))
            container.mux(stream.encode())
    finally:
        pictures.close()


class Pictures:
    """The pictures of a film, motions side by side; holds an OpenGL context until closed."""

    def __init__(
        self,
        machine: Machine,
        motions: Sequence[Truth],
        loads: Sequence[Load],
        titles: Sequence[str],
        caption: Callable[[int, int], str] | None,
        size: tuple[int, int],
        view: tuple[float, float],
        floor: float | None,
    ) -> None:
        """As for `film`."""
        try:
            import mujoco
            from PIL import ImageFont

            self._font = ImageFont.load_default(16)
        except ImportError as error:
            raise MachineError("film: Pillow is missing; expected `pip install pillow`") from error
        self._motions, self._titles, self._caption = motions, titles, caption
        self._scene = Scene.of(machine, loads, floor=floor)
        self._carriers = [
            [holding(load, motion.time, motion.position) for load in loads] for motion in motions
        ]
        self._strip = _LINE * (2 if caption is None else 3) + 8
        self.width, self.height = size[0] * len(motions), size[1] + self._strip
        model = self._scene.model
        model.vis.global_.offwidth, model.vis.global_.offheight = size
        try:
            self._renderer: Any = mujoco.Renderer(model, size[1], size[0])
        except Exception as error:  # whatever the platform's OpenGL raises
            raise MachineError(
                "film: no OpenGL without a screen; expected MUJOCO_GL=egl or osmesa in the"
                f" environment ({error})"
            ) from error
        self._camera = mujoco.MjvCamera()
        shoulder = float(model.body_pos[1, 2])
        self._camera.lookat[:] = 0.0, 0.0, 0.8 * shoulder + 0.2 * self._scene.ground
        self._camera.distance = 2.0 * self._scene.size
        self._camera.azimuth, self._camera.elevation = view

    def at(self, sample: int) -> np.ndarray:
        """The picture of a sample, (height, width, 3) of 8 bits."""
        return np.concatenate(
            [self._one(number, sample) for number in range(len(self._motions))], axis=1
        )

    def close(self) -> None:
        """Closes the OpenGL context."""
        self._renderer.close()

    def _one(self, number: int, sample: int) -> np.ndarray:
        from PIL import Image, ImageDraw

        motion = self._motions[number]
        self._scene.update(
            motion.position[sample], [carrier[sample] for carrier in self._carriers[number]]
        )
        self._renderer.update_scene(self._scene.data, self._camera)
        self._scene.draw(self._renderer.scene)
        picture = self._renderer.render()
        strip = Image.new("RGB", (picture.shape[1], self._strip), "white")
        draw = ImageDraw.Draw(strip)
        title = self._titles[number] if self._titles else ""
        carried = float(motion.carried[sample])
        load = f"   carries {carried:g} kg" if carried else ""
        lines = [title, f"{motion.time[sample]:6.2f} s{load}"]
        if self._caption is not None:
            lines.append(self._caption(number, sample))
        for row, line in enumerate(lines):
            draw.text((10, 4 + row * _LINE), line, fill=_INK, font=self._font)
        return np.concatenate([picture, np.asarray(strip)], axis=0)


def _check(
    path: Path,
    motions: Sequence[Truth],
    titles: Sequence[str],
    speed: float,
    rate: int,
    size: tuple[int, int],
) -> None:
    if path.suffix.lower() != ".mp4":
        raise MachineError(f"film: {path}; expected a name that ends in .mp4")
    if not motions or len({motion.time.size for motion in motions}) != 1:
        raise MachineError("film: expected one or more motions of as many samples each")
    if titles and len(titles) != len(motions):
        raise MachineError(f"film: {len(titles)} titles for {len(motions)} motions")
    if not speed > 0 or rate < 1:
        raise MachineError(f"film: speed is {speed} and rate {rate}; expected more than zero")
    if min(size) < 2 or any(value % 2 for value in size):
        raise MachineError(f"film: size is {size}; expected even numbers of pixels")
