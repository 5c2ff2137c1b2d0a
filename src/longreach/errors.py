"""What callers can catch: every error that longreach raises on purpose is a `LongreachError`."""


class LongreachError(Exception):
    """Something that the caller can mend; the message is one sentence that says how."""


class RecordingError(LongreachError):
    """A recording, or one message in it, cannot be used."""


class ConfigError(LongreachError):
    """A configuration file or value cannot be used."""


class EstimationError(LongreachError):
    """The measurements given cannot be turned into an estimate."""


class PlanningError(LongreachError):
    """A reference, a task or a path cannot be planned with."""


class ModelError(LongreachError):
    """A robot's model, a frame of it, or a configuration for it cannot be used."""


class ControlError(LongreachError):
    """A command, a controller or its input cannot be used."""


class LiveError(LongreachError):
    """A robot at the other end of a network cannot be reached, refuses a command, or was stopped."""


class MappingError(LongreachError):
    """A map, its pose graph or its file cannot be used."""


class CalibrationError(LongreachError):
    """Motions show nothing of what is to be calibrated, or contradict the description."""
