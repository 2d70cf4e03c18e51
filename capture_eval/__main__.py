"""``python -m capture_eval``: the same as the command ``capture-eval``."""

from capture_eval.command_line.main import main

if __name__ == "__main__":
    main()
