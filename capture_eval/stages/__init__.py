"""One function per arrow of the pipeline: load, call, save."""
