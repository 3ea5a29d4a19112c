"""Plans: footholds, times, and the motion of body and feet between them."""

from __future__ import annotations

from dataclasses import dataclass

from aslip.base.arrays import Array, namespace
from aslip.planning.pendulum import Pendulum
from aslip.planning.program import Problem, Program
from aslip.planning.state import WalkState, quintic, swing
from aslip.planning.stones import Stones
from aslip.rom.motion import Angle, Track

# least force on the ground, as a share of the weight
_LEAST_LOAD = 0.1


@dataclass(frozen=True, eq=False)
class PlanSample:
    """Motion of robots at m times; left before right on every foot axis."""

    body: Track
    """(m, 3) body, mapped to the origin of the pelvis."""
    feet: Track
    """(m, 2, 3) feet, mapped to the centres of the soles."""
    foot_acceleration: Array
    """(m, 2, 3) [m/s^2]."""
    ground_force: Array
    """(m, 2, 3) force of the ground on each foot [N]."""
    pressure: Array
    """(m, 2) centre of pressure of each foot ahead of its middle, along the toes [m]."""
    heading: Angle
    """(m,) heading of the body."""
    foot_heading: Array
    """(m, 2) direction of the toes [rad]."""
    contact: Array
    """(m, 2) bool, foot on the ground."""
    stance: Array
    """(m,) foot that landed last, 0 or 1."""
    since: Array
    """(m,) time since its touchdown [s]."""
    lift_off: Array
    """(m, 3) where the other foot stood last [m]."""

    @property
    def ground(self) -> Array:
        """(m,) height below the body, which follows the load in double stance [m]."""
        xp, load = namespace(self.since), self.ground_force[..., 2]
        rows = xp.arange(len(self.since), device=self.since.device)
        share = load[rows, self.stance] / load.sum(-1)
        stood = self.feet.position[rows, self.stance, 2]
        return share * stood + (1 - share) * self.lift_off[:, 2]

    def state(self) -> WalkState:
        """State from which planning goes on if all went as planned."""
        return WalkState(
            body_position=self.body.position,
            body_velocity=self.body.velocity,
            foot_position=self.feet.position,
            foot_velocity=self.feet.velocity,
            foot_acceleration=self.foot_acceleration,
            foot_heading=self.foot_heading,
            lift_off=self.lift_off,
            stance=self.stance,
            since=self.since,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Plan:
    """Next N footsteps of n robots, in the frames of the state that they begin in.

    Time counts from that state.
    """

    state: WalkState
    """State that the plan begins in."""
    time: Array
    """(n, N) times of the touchdowns [s]."""
    foothold: Array
    """(n, N, 3) where the feet land [m]."""
    heading: Array
    """(n, N) heading of the landing feet, that of the body at the nominal times [rad]."""
    yaw_rate: Array
    """(n,) turn of the body [rad/s]."""
    stones: Array
    """(n, N) index of the stone of each foothold, -1 for the floor."""
    on_stones: Array
    """(n,) number of first footholds that stones allow; N if they allow all, or without stones.
    If 0, the next is the safest instead: as close to a stone as possible."""
    within_limits: Array
    """(n,) bool, False if no step keeps the limits of the robot, and the next one violates some."""
    cost: Array
    """(n,) cost of the plan."""
    body: tuple[Array, Array]
    """Positions and velocities (n, N + 1, 3) of the body now and at the touchdowns, its height
    without the bounce of steps [m, m/s]."""
    pressure: Array
    """(n, 2) centre of pressure in single stance, from the stance foot, until the next touchdown
    [m]."""
    pendulum: Pendulum
    """Model of the body's motion."""
    clearance: float
    """Height of the swing foot at half swing above the higher foothold [m]."""

    @classmethod
    def of(
        cls,
        program: Program,
        problem: Problem,
        state: WalkState,
        command: Array,
        *,
        variable: Array,
        steps: Array,
        stones: Stones | None,
        chosen: Array,
        on_stones: Array,
        within_limits: Array,
        cost: Array,
    ) -> Plan:
        """Plan of the variables of its program: t (n,) and steps (n, N, 2)."""
        xp, p, time = namespace(variable), program.pendulum, program.later(problem, variable)
        level = problem.stance[:, None, :2] + steps.cumsum(1)
        heights, floor = [], problem.stance[:, 2]
        for k in range(program.steps):
            floor = floor if stones is None else stones.height(chosen[:, k], floor)
            heights.append(floor)
        foothold = xp.concatenate([level, xp.stack(heights, -1)[..., None]], -1)
        order = xp.arange(program.steps, device=time.device)
        times = time[:, None] + p.step_time * order
        return cls(
            state=state,
            time=times,
            foothold=foothold,
            heading=problem.heading,
            yaw_rate=command[:, 2],
            stones=chosen,
            on_stones=on_stones,
            within_limits=within_limits,
            cost=cost,
            body=_bodies(program, problem, state, variable, steps, foothold),
            pressure=problem.pressure,
            pendulum=p,
            clearance=program.limits.clearance,
        )

    @property
    def command(self) -> Array:
        """(n, 3) mean velocity of the body over all steps [m/s], and its yaw rate [rad/s]."""
        way = (self.body[0][:, -1] - self.body[0][:, 0])[:, :2]
        turn = self.yaw_rate[:, None]
        return namespace(turn).concatenate([way / self.time[:, -1:], turn], -1)

    def sample(self, time: Array) -> PlanSample:
        """Motion at a time of each robot, (n,), or at one after another of all, (k n,) [s].

        Times from 0 to the last touchdown; others are moved there.
        """
        xp, s = namespace(time), self.state
        zero, rows = 0.0 * time, xp.arange(len(time), device=time.device) % len(s.since)
        time = xp.minimum(time.clip(0.0), self.time[rows, -1])
        done = (time[:, None] >= self.time[rows, :-1]).sum(-1)
        # the state first, then the touchdowns, as far as footsteps begin there
        began = xp.where(done == 0, zero, self.time[rows, done - 1])
        since = xp.where(done == 0, s.since[rows], zero)
        step = _Footstep(
            stance=self._stood(rows, done),
            pressure=xp.where(done[:, None] == 0, self.pressure[rows], zero[:, None]),
            last=self._stood(rows, done - 1),
            target=self.foothold[rows, done],
            since=since,
            shift=(self.pendulum.double_stance - since).clip(0.0),
            landing=self.time[rows, done] - began,
            elapsed=time - began,
        )
        side = (s.stance[rows] + done) % 2
        feet, acceleration, contact = self._feet(step, rows, done, side)
        body, pressed = self._body(step, rows, done)
        share = ((step.since + step.elapsed) / self.pendulum.double_stance).clip(0.0, 1.0)[:, None]
        toes = self._foot_heading(step, rows, done, side)
        stood = xp.where(side == 0, toes[:, 0], toes[:, 1])
        ahead = xp.cos(stood) * step.pressure[:, 0] + xp.sin(stood) * step.pressure[:, 1]
        return PlanSample(
            body=body,
            feet=feet,
            foot_acceleration=acceleration,
            ground_force=_by_side(side, share * pressed, (1 - share) * pressed),
            pressure=_by_side(side, ahead, 0 * ahead),
            heading=Angle(self.yaw_rate[rows] * time, self.yaw_rate[rows] + zero),
            foot_heading=toes,
            contact=contact,
            stance=side,
            since=step.since + step.elapsed,
            lift_off=step.last,
        )

    def _stood(self, rows: Array, done: Array) -> Array:
        """Place (m, 3) of the foot that landed at touchdown `done`; 0 is the last before now."""
        xp, s = namespace(done), self.state
        stance = s.of_foot(s.foot_position, swing=False)[rows]
        before = xp.where((done < 0)[:, None], s.lift_off[rows], stance)
        return xp.where((done > 0)[:, None], self.foothold[rows, (done - 1).clip(0)], before)

    def _body(self, step: _Footstep, rows: Array, done: Array) -> tuple[Track, Array]:
        """Body, and force of the ground on it (m, 3)."""
        xp, p = namespace(step.elapsed), self.pendulum
        position, velocity = (knots[rows, done] for knots in self.body)
        under = step.stance + xp.concatenate([step.pressure, 0 * step.stance[:, 2:]], -1)
        before = (step.since / p.double_stance).clip(0.0, 1.0)[:, None]
        start = step.last + before * (step.stance - step.last)
        level = p.flow(
            position[:, :2], velocity[:, :2], start[:, :2], under[:, :2], step.shift, step.elapsed
        )
        rest = xp.zeros_like(position[:, 2:])
        ends = [knots[rows, done + 1][:, 2:] for knots in self.body]
        up = quintic(
            (position[:, 2:], velocity[:, 2:], rest), (*ends, rest), step.landing, step.elapsed
        )
        bounce = p.bounced(step.since + step.elapsed, step.since + step.landing)
        up = [value + one[:, None] for value, one in zip(up, bounce, strict=True)]
        body = Track(*(xp.concatenate([a, b], -1) for a, b in zip(level, up, strict=False)))
        share = (step.elapsed / step.shift.clip(1e-9)).clip(0.0, 1.0)[:, None]
        lever = body.position - start - share * (under - start)
        # feet do not pull, however high the bounce
        load = (bounce[2] + p.gravity).clip(_LEAST_LOAD * p.gravity)[:, None]
        return body, p.mass * xp.concatenate([p.rate**2 * lever[:, :2], rest + load], -1)

    def _feet(
        self, step: _Footstep, rows: Array, done: Array, side: Array
    ) -> tuple[Track, Array, Array]:
        """Feet, their accelerations and contacts."""
        xp, s = namespace(done), self.state
        rest = xp.zeros_like(step.last)
        flying = ((done == 0) & (step.shift == 0))[:, None]
        motion = (s.foot_position, s.foot_velocity, s.foot_acceleration)
        found = [s.of_foot(a, swing=True)[rows] for a in motion]
        now = [xp.where(flying, a, b) for a, b in zip(found, (step.last, rest, rest), strict=True)]
        position, velocity, acceleration = swing(
            (now[0], now[1], now[2]),
            step.last,
            step.target,
            ((step.since - self.pendulum.double_stance).clip(0.0), step.landing - step.shift),
            self.clearance,
            (step.elapsed - step.shift).clip(0.0),
        )
        landed = step.elapsed >= step.landing
        down = landed | (step.elapsed < step.shift)
        position = xp.where(landed[:, None], step.target, position)
        velocity, acceleration = (
            xp.where(landed[:, None], rest, a) for a in (velocity, acceleration)
        )
        feet = Track(_by_side(side, step.stance, position), _by_side(side, rest, velocity))
        return feet, _by_side(side, rest, acceleration), _by_side(side, down | True, down)

    def _foot_heading(self, step: _Footstep, rows: Array, done: Array, side: Array) -> Array:
        """Directions of the toes (m, 2); in flight they turn evenly."""
        xp, s = namespace(done), self.state
        ours, other = (s.of_foot(s.foot_heading, swing=one)[rows] for one in (False, True))
        stance = xp.where(done == 0, ours, self.heading[rows, done - 1])
        from_ = xp.where(done > 1, self.heading[rows, done - 2], xp.where(done == 1, ours, other))
        share = ((step.elapsed - step.shift) / (step.landing - step.shift)).clip(0.0, 1.0)
        return _by_side(side, stance, from_ + share * (self.heading[rows, done] - from_))


@dataclass(frozen=True, eq=False)
class _Footstep:
    """The footstep of m samples, from a touchdown or the state of the plan on."""

    stance: Array
    """(m, 3) foothold of the stance foot [m]."""
    pressure: Array
    """(m, 2) centre of pressure from there in single stance [m]."""
    last: Array
    """(m, 3) last foothold of the other foot [m]."""
    target: Array
    """(m, 3) its next one [m]."""
    since: Array
    """(m,) time since the touchdown when the footstep begins here [s]."""
    shift: Array
    """(m,) rest of double stance then [s]."""
    landing: Array
    """(m,) time until the next touchdown then [s]."""
    elapsed: Array
    """(m,) time of the sample since then [s]."""


def _by_side(side: Array, stance: Array, swing: Array) -> Array:
    """Values (m, 2, ...) of left and right foot from those (m, ...) of stance and swing foot."""
    xp = namespace(side)
    left = (side == 0).reshape(-1, *(1,) * (stance.ndim - 1))
    return xp.stack([xp.where(left, stance, swing), xp.where(left, swing, stance)], 1)


def _bodies(
    program: Program,
    problem: Problem,
    state: WalkState,
    variable: Array,
    steps: Array,
    foothold: Array,
) -> tuple[Array, Array]:
    """Positions and velocities (n, N + 1, 3) of the body now and at the touchdowns."""
    xp, begin = namespace(variable), (state.body_position, state.body_velocity)
    ends = program.bodies(problem, variable, steps)
    ends = (ends[0] + foothold[..., :2], ends[1])
    level = [xp.concatenate([a[:, None, :2], b], 1) for a, b in zip(begin, ends, strict=True)]
    height = _heights(program.pendulum, state, foothold, program.later(problem, variable))
    position, velocity = (xp.concatenate(pair, -1) for pair in zip(level, height, strict=True))
    return position, velocity


def _heights(p: Pendulum, state: WalkState, foothold: Array, landing: Array) -> tuple[Array, Array]:
    """Heights and vertical velocities (n, N + 1, 1) of the body now and at the touchdowns.

    They are those without the bounce of steps; `landing` (n,) is the time until the next one.
    """
    xp, bounce = namespace(foothold), p.bounced(state.since, state.since + landing)
    stance = state.of_foot(state.foot_position, swing=False)
    under = xp.concatenate([xp.stack([state.lift_off, stance], 1), foothold], 1)[..., 2:]
    height = p.height + (under[:, 1:] + under[:, :-1]) / 2
    rise = (height[:, 1:] - height[:, :-1]) / p.step_time
    slope = xp.concatenate([(rise[:, 1:] + rise[:, :-1]) / 2, rise[:, -1:]], 1)
    now = (state.body_position[:, 2] - bounce[0], state.body_velocity[:, 2] - bounce[1])
    return tuple(
        xp.concatenate([one[:, None, None], later], 1)
        for one, later in zip(now, (height[:, 1:], slope), strict=True)
    )
