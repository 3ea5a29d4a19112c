"""A loop in step with the clock on the wall."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

MOST_BEHIND = 0.1
"""Of what a stall costs, so much is caught up [s]; the rest is let go, or a long stall would be
followed by a robot in fast motion, and on a slow machine by ever more of it."""

# over which the factor is measured [s]
_WINDOW = 2.0


class Pacer:
    """Waits so that a loop takes one period a turn, on average: no wait's error adds up.

    Args:
        period: of the loop [s].
        clock: seconds from any start, never going back.
        sleep: waits for so many seconds, or less.
    """

    def __init__(
        self,
        period: float,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] = time.sleep,
    ) -> None:
        self._period = period
        self._clock = clock
        self._sleep = sleep
        self._turns: deque[float] = deque(maxlen=round(_WINDOW / period) + 1)
        self.restart()

    def restart(self) -> None:
        """Begin now, with nothing to catch up."""
        self._due = self._clock()
        self._turns.clear()
        self._turns.append(self._due)

    def wait(self) -> None:
        """Wait for the end of the loop's present turn; not at all if it is over."""
        self._due += self._period
        now = self._clock()
        if now < self._due:
            self._sleep(self._due - now)
        else:
            self._due = max(self._due, now - MOST_BEHIND)
        self._turns.append(self._clock())

    @property
    def factor(self) -> float:
        """Periods passed in the last two seconds over time passed; 1 in real time."""
        elapsed = self._turns[-1] - self._turns[0]
        return (len(self._turns) - 1) * self._period / elapsed if elapsed > 0 else 1.0
