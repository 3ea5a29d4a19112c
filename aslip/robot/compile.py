"""Skeleton of an MJCF, compiled by MuJoCo."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from aslip.robot.skeleton import Body, Connection, Geom, Joint, Sensor, Site, Skeleton

_CONNECT = int(mujoco.mjtEq.mjEQ_CONNECT)
_KINDS = ("free", "ball", "slide", "hinge")


def compile_skeleton(mjcf: Path) -> Skeleton:
    """Compile an MJCF without visual geoms, and collect its skeleton."""
    spec = mujoco.MjSpec.from_file(str(mjcf))
    spec.compiler.discardvisual = True
    return skeleton_of(spec.compile())


def skeleton_of(model: mujoco.MjModel) -> Skeleton:
    """Collect the skeleton of a compiled model."""
    bodies = [model.body(i) for i in range(model.nbody)]
    joints = [model.joint(i) for i in range(model.njnt)]
    sites = [model.site(i) for i in range(model.nsite)]
    geoms = [geom for geom in map(model.geom, range(model.ngeom)) if geom.name]
    loops = [loop for loop in map(model.equality, range(model.neq)) if loop.type[0] == _CONNECT]
    sensors = [model.sensor(i) for i in range(model.nsensor)]
    return Skeleton(
        num_qpos=int(model.nq),
        num_qvel=int(model.nv),
        bodies={b.name: _body(b, bodies[b.parentid[0]].name) for b in bodies},
        joints={joint.name: _joint(model, joint) for joint in joints},
        sites={
            s.name: Site(int(s.id), bodies[s.bodyid[0]].name, _vector(s.pos), _vector(s.quat))
            for s in sites
        },
        geoms={
            g.name: Geom(bodies[g.bodyid[0]].name, *map(_vector, (g.pos, g.quat, g.size)))
            for g in geoms
        },
        connections={
            e.name: Connection(
                *(bodies[i].name for i in (e.obj1id[0], e.obj2id[0])),
                *(_vector(point) for point in np.split(e.data[:6], 2)),
            )
            for e in loops
        },
        sensors={s.name: Sensor(int(s.adr[0]), int(s.dim[0])) for s in sensors},
        standing=_vector(model.key("standing").qpos),
    )


def _body(body: Any, parent: str) -> Body:
    return Body(
        index=int(body.id),
        parent=parent,
        position=_vector(body.pos),
        quaternion=_vector(body.quat),
        mass=float(body.mass[0]),
        centre=_vector(body.ipos),
        axes=_vector(body.iquat),
        inertia=_vector(body.inertia),
    )


def _joint(model: mujoco.MjModel, joint: Any) -> Joint:
    kind = _KINDS[int(joint.type[0])]
    return Joint(
        body=model.body(joint.bodyid[0]).name,
        kind=kind,
        qpos=int(joint.qposadr[0]),
        qvel=int(joint.dofadr[0]),
        zero=float(model.qpos0[joint.qposadr[0]]) if kind in ("slide", "hinge") else 0.0,
        stiffness=float(joint.stiffness[0]),
        armature=float(joint.armature[0]),
        range=_vector(joint.range) if joint.limited[0] else (),
    )


def _vector(values: np.ndarray) -> tuple[float, ...]:
    return tuple(np.ravel(values).tolist())
