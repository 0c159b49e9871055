"""The errors a user can cause or meet, each with the exit code the command line turns it into."""


class InputError(ValueError):
    """Bad input: a file, a setting or a value. Names the file, the element and the way out. Exit code 2."""


class EnvironmentLacks(RuntimeError):
    """The machine lacks something (LLVM, OpenCL, memory). Carries the line that mends it. Exit code 3."""
