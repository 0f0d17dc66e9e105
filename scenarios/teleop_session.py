"""The teleop session: who drives, what is recorded, and how the twin is wound back. Fed with keys, 50 ms at a time.

It knows no device and no clock, so that a script, a terminal and a browser drive the same session, and equal keys give
equal files.

* The planner drives until a person takes over. `1`, `2`, `3` begin an intervention of type A, B, D: from then on the
  person drives and every tick is recorded, until Enter saves it and hands back.
* A driving key without an intervention is a nudge: as in twist_mux the person goes first, and HOLD seconds after the
  robot was let go the planner drives on. A nudge is not recorded.
* While R is held the session shows ever earlier ticks; on release the tape is wound back to the one that is shown, and
  the twin waits there, standing still in time, until the person drives on or hands back.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from learning.interventions import Kind, Step, save_intervention
from scenarios.keyboard import DISCARD, HOLD, KINDS, QUIT, REWIND, SAVE, TURBO, Keys, Stick
from scenarios.teaching import LONGEST, Taught, highest_numbers
from scenarios.teleop_view import Frame, Mode, Sight, View
from twin.records import Array, Command, Outcome, Tick, Twist2
from twin.rewind import Tape
from twin.simulation import TICK

REWIND_STEP = 2  # ticks per frame: twice as fast as life
FAST_REWIND_STEP = 8  # with Shift
STANDS = 0.02  # [m/s] slower than this the robot has stopped


class TeleopSession:
    """One drive with a person at the keys. `frame` is called every 50 ms until `finished`."""

    def __init__(self, tape: Tape, out: Path, world_name: str, seed: int) -> None:
        """Interventions go to the folder `out`, labelled on from those that are there."""
        self._tape, self._out, self._world_name, self._seed = tape, out, world_name, seed
        self._numbers = highest_numbers(out)
        self._stick = Stick()
        self._hands_on = False  # the person drives
        self._idle = 0.0  # [s] since a nudge was let go and came to rest
        self._taught: Taught | None = None
        self._noticed: tuple[int, str] | None = None  # a rewind without an intervention: from where
        self._cursor: int | None = None  # the tick shown while rewinding
        self._waiting = False
        self._met = False  # somebody has been at the keys
        self._outcome: Outcome | None = None  # that stopped the twin
        self._late = False  # the trial's time is over; told once
        self._message = "the planner drives"
        self.saved: list[Path] = []
        self._labels: list[str] = []
        self.finished = False
        simulation = tape.loop.simulation
        start = Frame(
            tape.position, 0.0, 0.0, simulation.snapshot().physics, simulation.true_pose, Twist2(0.0, 0.0), None, None
        )
        self._frames = {start.index: start}

    # --- one frame ---------------------------------------------------------------------------------------------------

    def frame(self, keys: Keys) -> View:
        """Live through 50 ms with these keys. Raises OSError when the last intervention cannot be saved on quitting."""
        for key in keys.pressed:
            self._press(key)
        if not self.finished:
            if REWIND in keys.held or REWIND in keys.pressed:
                self._scrub(FAST_REWIND_STEP if TURBO in keys.held else REWIND_STEP)
            else:
                self._land()
                self._go_on(keys)
        return self.view()

    def view(self) -> View:
        """How things stand."""
        at = self._tape.position
        shown = at if self._cursor is None else self._cursor
        taught = self._taught
        steps = 0 if taught is None else sum(k < shown for k in taught.steps)
        return View(
            world=self._tape.loop.simulation.world,
            mode=self._mode,
            frame=self._frames[shown],
            label=None if taught is None else self._next_label(taught.kind),
            recorded=steps * TICK,
            trail=self._trail(shown),
            rewound=(at - shown) * TICK,
            saved=tuple(self._labels),
            message=self._message,
        )

    @property
    def _mode(self) -> Mode:
        if self._cursor is not None:
            return Mode.REWIND
        if self._outcome is not None:
            return Mode.ENDED
        if self._waiting:
            return Mode.WAITING
        if self._taught is not None:
            return Mode.INTERVENTION
        return Mode.NUDGE if self._hands_on else Mode.PLANNER

    def _trail(self, shown: int) -> Array:
        if self._taught is None:
            return np.empty((0, 2))
        frames = [self._frames[k] for k in sorted(self._taught.steps) if k < shown and k in self._frames]
        return np.array([(f.pose.x, f.pose.y) for f in frames]).reshape(-1, 2)

    # --- keys --------------------------------------------------------------------------------------------------------

    def _press(self, key: str) -> None:
        if key in KINDS:
            self._begin(KINDS[key])
        elif key == SAVE:
            self._hand_back()
        elif key == DISCARD:
            self._discard()
        elif key == QUIT:
            self._quit()

    def _begin(self, kind: Kind) -> None:
        if self._taught is not None:  # a slip of the finger: the type can be changed until it is saved
            self._taught.kind = kind
        else:
            at = self._tape.position
            noticed, state = self._noticed or (at, self._state(at))
            self._taught = Taught(kind, noticed, state)
            if not self._hands_on:
                self._take_over()
        self._message = f"intervention {self._next_label(kind)}: drive, then Enter"
        if self._outcome is not None and self._cursor is None:
            self._message += "; hold R first, the run has ended here"

    def _hand_back(self) -> None:
        self._land()
        if self._taught is not None:
            if self._outcome is Outcome.COLLIDED:
                self._message = "it touched something: R winds back, Backspace discards"
                return
            try:
                self._save()
            except OSError as error:
                self._waiting = True
                self._message = f"NOT saved: {error.strerror or error}; make room and press Enter again"
                return
        elif self._outcome is not None:
            self._message = f"{self._outcome.value}: hold R to wind back, Q to quit"
            return
        else:
            self._message = "the planner drives"
        self._release()

    def _discard(self) -> None:
        self._land()
        if self._taught is None:
            self._message = "there is nothing to discard"
            return
        self._message = f"{self._next_label(self._taught.kind)} discarded; hold R to try again"
        self._taught = None
        self._release()

    def _quit(self) -> None:
        self._land()
        if self._taught is not None and self._taught.steps and self._outcome is not Outcome.COLLIDED:
            self._save()
        self.finished = True

    def _release(self) -> None:
        """The planner drives on."""
        self._taught = self._noticed = None
        self._hands_on = self._waiting = False
        self._idle = 0.0

    def _take_over(self) -> None:
        """The person drives on, from the speed that the robot has."""
        self._hands_on, self._idle = True, 0.0
        self._stick = Stick.matching(self._frames[self._tape.position].twist)

    # --- driving -----------------------------------------------------------------------------------------------------

    def _go_on(self, keys: Keys) -> None:
        """One tick of the twin, unless it waits."""
        self._met |= not keys.lost
        if not self._met or self._outcome is not None or (self._waiting and not keys.driving):
            return
        self._waiting = False
        if keys.driving and not self._hands_on:
            self._take_over()
            self._message = "you drive; this is not recorded (1, 2, 3: intervene)"
        command: Command | None = None
        if self._hands_on:
            self._stick = Stick() if keys.lost else self._stick.advance(keys, TICK)  # dead-man: zero at once
            command = self._stick.command
            self._idle = self._idle + TICK if self._stick.at_rest and not keys.driving else 0.0
        tick = self._tape.step(command)
        self._keep(tick)
        if self._hands_on and keys.lost and abs(tick.observation.twist.v) < STANDS:
            self._waiting = True
            self._message = "nobody at the keys: stopped, and waiting"
        if self._taught is not None and command is not None:
            self._taught.steps[tick.index] = Step(tick.observation, command)
            if self._taught.seconds >= LONGEST:
                self._waiting = True
                self._message = f"{LONGEST:.0f} s are enough for one: Enter saves, R winds back, Backspace discards"
        elif self._hands_on and not self._waiting and self._idle >= HOLD - 1e-9:
            self._release()
            self._message = "the planner drives"
        self._judge(tick)

    def _judge(self, tick: Tick) -> None:
        """What an outcome means here: running out of time stops nobody, a planner that gave up only itself."""
        outcome = tick.outcome
        if outcome is Outcome.TIMED_OUT and not self._late:
            self._late = True
            self._message = "the trial's time is over; the session goes on"
        if outcome in (None, Outcome.TIMED_OUT) or (outcome is Outcome.ABORTED and self._hands_on):
            return
        self._outcome = outcome
        words = {Outcome.REACHED: "goal reached", Outcome.ABORTED: "move_base gave up"}
        hit = "" if tick.contact is None else f" with {tick.contact.obstacle}"
        self._message = words.get(outcome or Outcome.COLLIDED, f"collision{hit}") + ": hold R to wind back, Q to quit"
        if outcome is Outcome.REACHED and self._taught is not None:
            self._hand_back()

    def _keep(self, tick: Tick) -> None:
        """Remember the twin after `tick` for the screen."""
        simulation = self._tape.loop.simulation
        after = Frame(
            tick.index + 1,
            simulation.time,
            tick.elapsed,
            simulation.snapshot().physics,
            simulation.true_pose,
            tick.observation.twist,
            Sight.of(tick),
            tick.outcome,
        )
        self._frames[after.index] = after
        if after.index % 20 == 0:  # once a second: let go of what the tape has let go of
            self._frames = {k: f for k, f in self._frames.items() if k >= self._tape.oldest}

    # --- rewinding ---------------------------------------------------------------------------------------------------

    def _scrub(self, ticks: int) -> None:
        """Show an earlier tick; the tape itself is wound once, on release."""
        at = self._tape.position
        if self._cursor is None:
            self._cursor = at
            if self._noticed is None and self._taught is None:
                self._noticed = (at, self._state(at))
        self._cursor = max(min(self._frames), self._tape.oldest, self._cursor - ticks)
        end = " (the tape ends here)" if self._cursor == self._tape.oldest else ""
        self._message = f"{(at - self._cursor) * TICK:.1f} s back{end}; let go of R to stay here"

    def _land(self) -> None:
        """Put the twin where the rewind shows it."""
        if self._cursor is None:
            return
        index, self._cursor = self._cursor, None
        self._tape.rewind(index)
        self._frames = {k: f for k, f in self._frames.items() if k <= index}
        self._outcome, self._waiting = None, True
        if self._taught is not None:
            self._taught.wind_back(index)
        self._take_over()
        self._message = f"wound back to {self._frames[index].time:.2f} s: drive on, 1 2 3 to intervene, Enter: planner"

    def _state(self, index: int) -> str:
        sight = self._frames[index].sight
        return "at the start" if sight is None else sight.state

    # --- saving ------------------------------------------------------------------------------------------------------

    def _next_label(self, kind: Kind) -> str:
        return f"{kind}{self._numbers[kind] + 1}"

    def _save(self) -> None:
        """Write the intervention in progress; on OSError it stays in progress."""
        taught = self._taught
        assert taught is not None
        if not taught.steps:
            self._message = f"{self._next_label(taught.kind)} has no steps and was not saved"
            return
        label = self._next_label(taught.kind)
        path = save_intervention(taught.finished(label, self._world_name, self._seed), self._out)
        self._numbers[taught.kind] += 1
        self.saved.append(path)
        self._labels.append(label)
        self._taught = None
        then = "the planner drives" if self._outcome is None else f"{self._outcome.value}: R winds back, Q quits"
        self._message = f"{label} saved ({taught.seconds:.1f} s); {then}"
