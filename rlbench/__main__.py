"""`python -m rlbench` is the command `rlbench`."""

from rlbench.cli.app import app

if __name__ == "__main__":
    app(prog_name="rlbench")
