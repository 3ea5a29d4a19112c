"""Pacing of a real-time loop."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

MOST_BEHIND = 0.1
"""Longest delay that is caught up after a stall [s]; more would show the robot in fast motion."""

# window of the real-time factor [s]
_WINDOW = 2.0


class Pacer:
    """Timer that keeps the mean duration of a loop's turns at a period, without drift.

    Args:
        period: period of the loop [s].
        clock: monotonic clock [s].
        sleep: function that waits for a time [s] or less.
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
        """Restart now, without a delay to catch up."""
        self._due = self._clock()
        self._turns.clear()
        self._turns.append(self._due)

    def wait(self) -> None:
        """Wait until the present turn is over."""
        self._due += self._period
        now = self._clock()
        if now < self._due:
            self._sleep(self._due - now)
        else:
            self._due = max(self._due, now - MOST_BEHIND)
        self._turns.append(self._clock())

    @property
    def factor(self) -> float:
        """Real-time factor over the last two seconds: simulated time over elapsed time."""
        elapsed = self._turns[-1] - self._turns[0]
        return (len(self._turns) - 1) * self._period / elapsed if elapsed > 0 else 1.0
