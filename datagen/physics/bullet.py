"""Scene -> Trajectory with PyBullet: a fresh world for every scene; nothing of the engine leaves this file.

PyBullet lets a body's frame be its principal frame of inertia only, so every body is built in that frame and poses are
turned into the object frame on the way out. Quaternions are (x, y, z, w) inside PyBullet and (w, x, y, z) outside.
"""

import contextlib
import functools
import math
import os
import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from operator import itemgetter
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Float

from datagen.config import Physics
from datagen.errors import UsageError
from datagen.geometry import rotation_from_quaternion
from datagen.physics.rigid_body import multiply, principal_axes, shrink, wavefront_file, xyzw
from datagen.scene import Scene, Trajectory
from datagen.shapes.shape import Shape

_BODIES_AND_FORCE = itemgetter(1, 2, 9)
"""Entries of a contact point of PyBullet."""

GAP_RANGE = 0.02
"""Metres; larger gaps are reported as inf."""

FIRST_WITHOUT_WHEEL = (3, 12)
"""First Python version for which PyBullet has no wheels."""

_HULL_MARGIN = 0.001
"""Metres by which PyBullet inflates every convex hull."""

_TABLE_THICKNESS = 0.5
_TOUCHING = 0.0005
_TOUCH_CLEARANCE = 0.0002
_TOUCH_STEPS = 40


class World:
    """One scene inside PyBullet: `start` brings it to frame 0, `run` simulates the rest; a context manager.

    Raises:
        UsageError: PyBullet is not installed; says what to do.
    """

    def __init__(self, scene: Scene, shapes: Sequence[Shape], physics: Physics):
        self._scene, self._shapes, self._physics = scene, shapes, physics
        self._bullet = _bullet()
        self._radii = [shape.radius for shape in shapes]
        self._axes = [principal_axes(shape.inertia) for shape in shapes]
        self._steps = max(1, math.ceil(1 / (scene.fps * physics.step) - 1e-9))
        self._dt = 1 / (scene.fps * self._steps)

    def __enter__(self) -> "World":
        self._client = _client()
        self._call("resetSimulation")
        self._call(
            "setPhysicsEngineParameter",
            fixedTimeStep=self._dt,
            deterministicOverlappingPairs=1,
            contactSlop=0,
            enableFileCaching=0,
        )
        self._call("setGravity", 0, 0, -self._physics.gravity)
        # PyBullet would make a picture of every collision shape; one empty picture for all saves that.
        self._picture = self._call("createVisualShape", self._bullet.GEOM_SPHERE, radius=1e-3)
        self._ids = [self._add_table(), *map(self._add, range(len(self._shapes)))]
        self._rows = {body: row for row, body in enumerate(self._ids)}
        return self

    def __exit__(self, *_: object) -> None:
        self._call("resetSimulation")

    def start(self) -> Trajectory:
        """Bring touching objects together, let everything settle, set the velocities; a one-frame trajectory."""
        for row, body in enumerate(self._scene.bodies, 1):
            if body.touches is not None:
                self._bring_together(row, body.touches + 1)
        for _ in range(round(self._physics.settle_seconds / self._dt)):
            self._bullet.stepSimulation(physicsClientId=self._client)
        for row, body in enumerate(self._scene.bodies, 1):
            if any(body.linear_velocity) or any(body.angular_velocity):
                self._call("resetBaseVelocity", self._ids[row], body.linear_velocity, body.angular_velocity)
        self._frames = [self._frame(np.zeros((len(self._ids),) * 2))]
        return self.trajectory

    def run(self) -> Trajectory:
        """Simulate from frame 0 to the last frame."""
        for frame in range(len(self._frames), self._scene.frames):
            self._frames.append(self._frame(self._advance((frame - 1) / self._scene.fps)))
        return self.trajectory

    @property
    def trajectory(self) -> Trajectory:
        """All frames so far."""
        return Trajectory(*(np.stack(arrays).astype(np.float32) for arrays in zip(*self._frames, strict=True)))

    def _call(self, function: str, *arguments: Any, **options: Any) -> Any:
        return getattr(self._bullet, function)(*arguments, **options, physicsClientId=self._client)

    def _add_table(self) -> int:
        half = self._scene.table.size / 2
        shape = self._call(
            "createCollisionShape", self._bullet.GEOM_BOX, halfExtents=[half, half, _TABLE_THICKNESS / 2]
        )
        table = self._call(
            "createMultiBody",
            0,
            shape,
            self._picture,
            basePosition=[0, 0, -_TABLE_THICKNESS / 2],
            useMaximalCoordinates=True,
        )
        self._set_surface(table, self._physics.table_friction, self._physics.table_restitution)
        return table

    def _add(self, row: int) -> int:
        body, shape = self._scene.bodies[row], self._shapes[row]
        moments, object_from_principal = self._axes[row]
        mass = body.density * shape.volume
        body_id = self._call(
            "createMultiBody",
            mass,
            self._collision_shape(shape, object_from_principal),
            self._picture,
            basePosition=body.position,
            baseOrientation=xyzw(multiply(np.array(body.quaternion_wxyz), object_from_principal)),
            useMaximalCoordinates=True,
        )
        self._call(
            "changeDynamics",
            body_id,
            -1,
            mass=mass,  # without it the call below divides by zero
            localInertiaDiagonal=(body.density * moments).tolist(),
            linearDamping=0,
            angularDamping=0,
        )
        self._set_surface(body_id, body.friction, body.restitution)
        return body_id

    def _set_surface(self, body_id: int, friction: float, restitution: float) -> None:
        self._call(
            "changeDynamics",
            body_id,
            -1,
            lateralFriction=friction,
            restitution=restitution,
            rollingFriction=self._physics.rolling_friction,
            spinningFriction=self._physics.spinning_friction,
        )

    def _collision_shape(self, shape: Shape, object_from_principal: Float[np.ndarray, "4"]) -> int:
        if shape.primitive:
            return self._primitive(*shape.primitive)
        rotation = rotation_from_quaternion(object_from_principal)
        parts = [shrink(part, _HULL_MARGIN) @ rotation for part in shape.convex_parts]
        # The only way to several hulls in one body leads through a file; one hull given as an array leaks memory.
        with wavefront_file(parts) as path:
            return self._call("createCollisionShape", self._bullet.GEOM_MESH, fileName=path)

    def _primitive(self, kind: str, lengths: tuple[float, ...]) -> int:
        if kind == "box":
            half = [length / 2 for length in lengths]
            return self._call("createCollisionShape", self._bullet.GEOM_BOX, halfExtents=half)
        if kind == "sphere":
            return self._call("createCollisionShape", self._bullet.GEOM_SPHERE, radius=lengths[0])
        round_kind = self._bullet.GEOM_CYLINDER if kind == "cylinder" else self._bullet.GEOM_CAPSULE
        return self._call("createCollisionShape", round_kind, radius=lengths[0], height=lengths[1])

    def _bring_together(self, row: int, other: int) -> None:
        """Move one body towards another until they all but touch; closing the gap alone can never make them overlap."""
        for _ in range(_TOUCH_STEPS):
            gap = self._gap(row, other, 1.0)
            if gap < _TOUCHING:
                return
            position, orientation = self._call("getBasePositionAndOrientation", self._ids[row])
            target, _ = self._call("getBasePositionAndOrientation", self._ids[other])
            direction = np.array([target[0] - position[0], target[1] - position[1], 0.0])
            direction /= max(np.sqrt(np.sum(direction**2)), 1e-9)
            position = np.array(position) + min(gap - _TOUCH_CLEARANCE, 1.0) * direction
            self._call("resetBasePositionAndOrientation", self._ids[row], position.tolist(), orientation)

    def _advance(self, now: float) -> Float[np.ndarray, "body body"]:
        """Simulate one frame interval from `now` (seconds); normal impulses exchanged in it."""
        step, contacts, client, dt = self._bullet.stepSimulation, self._bullet.getContactPoints, self._client, self._dt
        # Plain numbers: much of the loop's time is not the engine's.
        impulses: defaultdict[tuple[int, int], float] = defaultdict(float)
        pushed = any(body.push for body in self._scene.bodies)
        for number in range(self._steps):
            if pushed:
                self._push(now + number * dt)
            step(physicsClientId=client)
            for one, other, force in map(_BODIES_AND_FORCE, contacts(physicsClientId=client)):
                if force > 0:
                    impulses[one, other] += force * dt
        impulse = np.zeros((len(self._ids),) * 2)
        for (one, other), value in impulses.items():
            impulse[self._rows[one], self._rows[other]] = value
        return impulse + impulse.T

    def _push(self, time: float) -> None:
        for body_id, body in zip(self._ids[1:], self._scene.bodies, strict=True):
            if body.push and body.push.start <= time < body.push.start + body.push.duration:
                center, _ = self._call("getBasePositionAndOrientation", body_id)
                self._call("applyExternalForce", body_id, -1, body.push.force, center, self._bullet.WORLD_FRAME)

    def _frame(self, impulse: Float[np.ndarray, "body body"]) -> tuple[np.ndarray, ...]:
        poses = [self._pose(row) for row in range(len(self._shapes))]
        velocities = [self._call("getBaseVelocity", body_id) for body_id in self._ids[1:]]
        # The shapes are those of no object, too.
        position = np.array([pose[0] for pose in poses]).reshape(-1, 3)
        linear, angular = (np.array([velocity[i] for velocity in velocities]).reshape(-1, 3) for i in (0, 1))
        quaternion = np.array([pose[1] for pose in poses]).reshape(-1, 4)
        return position, quaternion, linear, angular, self._gaps(position), impulse

    def _pose(self, row: int) -> tuple[Sequence[float], Float[np.ndarray, "4"]]:
        position, (x, y, z, w) = self._call("getBasePositionAndOrientation", self._ids[row + 1])
        object_from_principal = self._axes[row][1]
        quaternion = multiply(np.array([w, x, y, z]), object_from_principal * [1, -1, -1, -1])
        return position, quaternion if quaternion[0] >= 0 else -quaternion

    def _gaps(self, position: Float[np.ndarray, "object 3"]) -> Float[np.ndarray, "body body"]:
        gaps = np.full((len(self._ids),) * 2, np.inf)
        for row, other in self._near_pairs(position):
            gaps[row, other] = gaps[other, row] = self._gap(row, other, GAP_RANGE)
        return gaps

    def _near_pairs(self, position: Float[np.ndarray, "object 3"]) -> Iterator[tuple[int, int]]:
        places = position.tolist()
        for row, place in enumerate(places):
            if place[2] < self._radii[row] + GAP_RANGE:
                yield row + 1, 0
            for other in range(row):
                if math.dist(place, places[other]) < self._radii[row] + self._radii[other] + GAP_RANGE:
                    yield row + 1, other + 1

    def _gap(self, row: int, other: int, reach: float) -> float:
        points = self._call("getClosestPoints", self._ids[row], self._ids[other], reach)
        gap = min((point[8] for point in points), default=math.inf)
        return gap if gap <= reach else math.inf


@functools.cache
def _bullet() -> ModuleType:
    try:
        with _quiet():
            import pybullet
    except ImportError as error:
        raise UsageError(_options()) from error
    return pybullet


def _options() -> str:
    """Everything that a user without PyBullet can do."""
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    install = "Install it: pip install 'obpose[simulate]'."
    if sys.version_info >= FIRST_WITHOUT_WHEEL:
        install += (
            " It has no wheels for Python 3.12 and later, so that pip builds it: about seven CPU-minutes, 1 GB of "
            "memory, and a C++ compiler (Debian, Ubuntu: apt-get install g++)."
        )
    choices = (
        install,
        "Use Python 3.11, for which pip installs a wheel.",
        "Simulate on another machine with --simulate-only, and make the images here: obpose-datagen render --from DIR.",
        "Use what exists: datasets from elsewhere can be trained on, segmented, scored and edited without PyBullet.",
    )
    listed = "".join(f"\n  {number}. {choice}" for number, choice in enumerate(choices, start=1))
    return f"Simulation needs PyBullet, which is not installed for this Python {version}. Choose one:{listed}"


@functools.cache
def _client() -> int:
    """The process's engine, emptied before and after every scene: connecting takes 11 ms, emptying 0.4 ms."""
    return _bullet().connect(_bullet().DIRECT)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep C code from writing to standard error, as PyBullet does when it is imported."""
    saved, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(nowhere)
