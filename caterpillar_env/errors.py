"""Errors that a caller can mend: each says what was expected, what came and what to do."""


class CaterpillarError(ValueError):
    """Base of every error that this project raises on purpose."""


class MorphologyError(CaterpillarError):
    """A body parameter is missing, unknown, not finite or outside its bounds."""


class TimingError(CaterpillarError):
    """Gait timings are of the wrong shape, not finite or outside the gait period."""


class PhysicsError(CaterpillarError):
    """A physical or numerical setting of the robot is not usable."""


class SimulationError(CaterpillarError):
    """A simulation was asked for something that it cannot do (rows, shapes, order of calls)."""
