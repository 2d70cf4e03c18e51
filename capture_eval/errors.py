"""The errors of the suite: one tree, one line of text each."""


class CaptureEvalError(Exception):
    """Anything the suite refuses or fails to do; its text is one line that says what to do about it."""


class InputError(CaptureEvalError, ValueError):
    """The input is bad: the text names the file, key, curve or shapes that are wrong."""


class ToolError(CaptureEvalError):
    """A program or library the suite calls failed or is missing."""


class ReconstructionError(CaptureEvalError):
    """Photos of a pose could not be turned into a scan."""


class RegistrationError(CaptureEvalError):
    """Scans could not be brought to one frame or one topology."""


class SolverError(CaptureEvalError, ValueError):
    """An equation has no (usable) solution for the parameters that the text names."""


class StageError(CaptureEvalError):
    """A stage of `run` failed: the text names the stage, the pose and the log."""
