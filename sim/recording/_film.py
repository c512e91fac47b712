"""Films of simulated motion, and the scene that they show."""

import fractions
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from jaxcslc._environment import require
from sim.engine._mjcf import mjcf
from sim.engine._simulate import Truth
from sim.machine._bodies import MachineError
from sim.machine._events import Load, during
from sim.machine._machine import Machine
from sim.trajectory._kinematics import Hand


# Okabe and Ito's palette, which colour-blind viewers distinguish: links in turn, loads.
_LINKS = ("#0072B2", "#E69F00", "#009E73", "#56B4E9", "#CC79A7", "#999999")
_LOAD = "#D55E00"
_JOINT = "#333333"
_BASE = "#777777"
# A load is drawn as a cube of water of its mass [kg/m³], of a visible size [m].
_DENSITY = 1000.0
_SMALLEST_LOAD = 0.05
# Length of the tool beyond the last link's frame, as a part of the arm's size.
_TOOL = 0.06


@dataclass(frozen=True, eq=False)
class Scene:
    """Geometry for drawing a machine: links as rods, the floor, and loads as boxes.

    MuJoCo computes the kinematics only; there is no dynamics.

    >>> import numpy as np
    >>> import sim
    >>> scene = sim.Scene.of(sim.puma560())
    >>> scene.update(np.zeros(6))
    >>> scene.data.xpos.shape
    (7, 3)
    """

    model: Any
    """MuJoCo's."""

    data: Any
    """MuJoCo's: positions of all bodies."""

    hand: Hand
    """The last link's frame."""

    centres: Float[np.ndarray, "loads 3"]
    """Of the loads, in the last link's frame [m]."""

    radii: Float[np.ndarray, " joints"]
    """Of the links' joints, as they are drawn [m]."""

    size: float
    """How far the arm reaches, about [m]."""

    ground: float
    """Height of the floor in frame 0 [m]."""

    carried: Bool[np.ndarray, " loads"]
    """Whether the hand holds each load, as of the last `update`."""

    @classmethod
    def of(
        cls, machine: Machine, loads: Sequence[Load] = (), *, floor: float | None = None
    ) -> "Scene":
        """The scene of a machine.

        **Arguments**

        - `machine`: the machine to draw.
        - `loads`: the loads of its trajectory.
        - `floor`: height of the floor in frame 0 [m]; if omitted 0 where the first joint is above
            that, and half the arm's reach below where it is not.
        """
        n = machine.joint_count
        spec = mujoco.MjSpec.from_string(mjcf(machine.robot, machine.links))
        origins = np.array([spec.body(f"link_{i + 1}").pos for i in range(n)])
        size = float(np.linalg.norm(origins, axis=1).sum()) or 1.0
        standing = origins[0][2] > 0.1 * size  # frame 0 is at the arm's foot
        ground = (0.0 if standing else -0.5 * size) if floor is None else floor
        _add_surroundings(spec, size, ground)
        radii = 0.05 * size * (1.0 - 0.6 * np.arange(n) / n)
        _add_links(spec, origins[0], radii, size, ground)
        centres = np.zeros((len(loads), 3))
        for number, load in enumerate(loads):
            centres[number] = np.asarray(load.body.centre_of_gravity)
            body = spec.worldbody.add_body(name=f"load_{number + 1}", mocap=True)
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=_half_sizes(load), rgba=_rgba(_LOAD))
        model = spec.compile()
        return cls(
            model,
            mujoco.MjData(model),
            Hand.of(machine.robot),
            centres,
            radii,
            size,
            ground,
            np.zeros(len(loads), dtype=bool),
        )

    def update(
        self,
        position: Float[np.ndarray, " joints"],
        carriers: Sequence[Float[np.ndarray, " joints"]] = (),
    ) -> None:
        """Moves links and loads to their positions.

        **Arguments**

        - `position`: of the joints [rad or m].
        - `carriers`: for each load, joint positions at which the hand holds it (see `holding`).
        """
        n = position.size
        self.data.qpos[:] = 0.0
        self.data.qpos[:n] = position
        for number, carrier in enumerate(carriers):
            self.carried[number] = np.array_equal(carrier, position)
            rotation, _ = self.hand.turn(carrier)
            point, _ = self.hand.locate(carrier)
            self.data.mocap_pos[number] = point + rotation @ self.centres[number]
            mujoco.mju_mat2Quat(
                self.data.mocap_quat[number], np.ascontiguousarray(rotation).ravel()
            )
        mujoco.mj_forward(self.model, self.data)

    def draw(self, canvas: Any) -> None:
        """Adds the shapes of varying length to a `MjvScene`: rods from joint to joint, and a stand
        below each load that is not carried."""
        origins = self.data.xpos[1 : len(self.radii) + 1]
        for i in range(len(self.radii) - 1):
            if np.linalg.norm(origins[i + 1] - origins[i]) > 1e-3 * self.size:
                colour = _LINKS[i % len(_LINKS)]
                _rod(canvas, origins[i], origins[i + 1], 0.8 * self.radii[i], colour)
        for point, carried in zip(self.data.mocap_pos, self.carried, strict=True):
            if not carried:
                _rod(canvas, point, np.array([*point[:2], self.ground]), self.radii[-1], _BASE)


def holding(
    load: Load, time: Float[np.ndarray, " samples"], position: Float[np.ndarray, "samples joints"]
) -> Float[np.ndarray, "samples joints"]:
    """Joint positions that correspond to a load's position, at each sample.

    Before it is picked up these are the positions at the pick-up, later those at the put-down.
    """
    carrying = np.flatnonzero(during(time, load.start, load.stop))
    if not carrying.size:
        return np.broadcast_to(position[-1], position.shape)
    # It is released at the first sample at which it is no longer carried.
    last = min(carrying[-1] + 1, len(time) - 1)
    return position[np.clip(np.arange(len(time)), carrying[0], last)]


def _rod(canvas: Any, start: Any, end: Any, radius: float, colour: str) -> None:
    rod, capsule = canvas.geoms[canvas.ngeom], mujoco.mjtGeom.mjGEOM_CAPSULE
    canvas.ngeom += 1
    mujoco.mjv_initGeom(
        rod, capsule, np.zeros(3), np.zeros(3), np.eye(3).ravel(), np.array(_rgba(colour))
    )
    mujoco.mjv_connector(rod, capsule, radius, start, end)


def _add_surroundings(spec: Any, size: float, ground: float) -> None:
    """Floor, light and background."""
    spec.visual.headlight.ambient = [0.35, 0.35, 0.35]
    spec.visual.headlight.diffuse = [0.35, 0.35, 0.35]
    spec.visual.headlight.specular = [0.0, 0.0, 0.0]
    spec.visual.quality.shadowsize = 2048
    spec.visual.map.znear = 0.01
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        rgb1=[1, 1, 1],
        rgb2=[1, 1, 1],
        width=32,
        height=192,
    )
    spec.add_texture(
        name="tiles",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.93, 0.93, 0.93],
        rgb2=[0.86, 0.86, 0.86],
        width=256,
        height=256,
    )
    floor = spec.add_material(name="floor", texrepeat=[4, 4], texuniform=True, reflectance=0.0)
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "tiles"
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[3 * size, 3 * size, 0.1],
        pos=[0, 0, ground],
        material="floor",
    )
    spec.worldbody.add_light(
        pos=[0.5 * size, -size, ground + 4 * size],
        dir=[-0.12, 0.25, -1],
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        diffuse=[0.5, 0.5, 0.5],
        specular=[0.1, 0.1, 0.1],
        castshadow=True,
    )


def _add_links(
    spec: Any,
    shoulder: Float[np.ndarray, "3"],
    radii: Float[np.ndarray, " joints"],
    size: float,
    ground: float,
) -> None:
    """Cylinders about the joints' axes, a column below the first, a tool at the last."""
    cylinder = mujoco.mjtGeom.mjGEOM_CYLINDER
    base = 1.3 * radii[0]
    spec.worldbody.add_geom(
        type=cylinder, fromto=[0, 0, ground, *shoulder], size=[base, 0, 0], rgba=_rgba(_BASE)
    )
    for i, radius in enumerate(radii):
        end = [0, 0, 1.15 * radius]
        spec.body(f"link_{i + 1}").add_geom(
            type=cylinder,
            fromto=[*(-np.array(end)), *end],
            size=[1.05 * radius, 0, 0],
            rgba=_rgba(_JOINT),
        )
    spec.body(f"link_{len(radii)}").add_geom(
        type=cylinder,
        fromto=[0, 0, 0, 0, 0, _TOOL * size],
        size=[0.8 * radii[-1], 0, 0],
        rgba=_rgba(_LINKS[(len(radii) - 1) % len(_LINKS)]),
    )


def _half_sizes(load: Load) -> list[float]:
    """Return half the sizes of the box that a load is drawn as [m]."""
    mass = float(load.body.mass)
    side = max((mass / _DENSITY) ** (1 / 3), _SMALLEST_LOAD)
    return [side / 2] * 3


def _rgba(colour: str) -> list[float]:
    return [*(int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)), 1.0]


_LINE = 22  # height of a line of text [pixels]
_INK = (30, 30, 30)
_RATE = 25  # pictures a second
_VIEW = 135.0, -20.0  # azimuth and elevation of the camera [degrees]


def film(
    path: Path | str,
    machine: Machine,
    truths: Truth | Sequence[Truth],
    *,
    loads: Sequence[Load] = (),
    titles: Sequence[str] = (),
    caption: Callable[[int, int], str] | None = None,
    size: tuple[int, int] = (640, 480),
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
    - `size`: of a motion's picture: width and height, even numbers [pixels].
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
    _check(path, motions, titles, size)
    av = require("av", "film")
    require("PIL", "film")
    pictures = Pictures(machine, motions, loads, titles, caption, size, floor)
    time = motions[0].time
    count = math.floor((time[-1] - time[0]) * _RATE) + 1
    shown = np.searchsorted(time, time[0] + np.arange(count) / _RATE - 1e-9)
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with av.open(str(path), "w") as container:
            stream = container.add_stream("libx264", rate=fractions.Fraction(_RATE))
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
        floor: float | None,
    ) -> None:
        """Take the arguments of `film`."""
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
        self._camera.azimuth, self._camera.elevation = _VIEW

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
    size: tuple[int, int],
) -> None:
    if path.suffix.lower() != ".mp4":
        raise MachineError(f"film: {path}; expected a name that ends in .mp4")
    if not motions or len({motion.time.size for motion in motions}) != 1:
        raise MachineError("film: expected one or more motions of as many samples each")
    if titles and len(titles) != len(motions):
        raise MachineError(f"film: {len(titles)} titles for {len(motions)} motions")
    if min(size) < 2 or any(value % 2 for value in size):
        raise MachineError(f"film: size is {size}; expected even numbers of pixels")
