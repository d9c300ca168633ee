"""The commands: each reads its command line and checks it, then imports what runs; `src/<name>.py` starts it.

Modules here import at their top only what is small, so that `--help` and mistakes are answered within a second.
"""
