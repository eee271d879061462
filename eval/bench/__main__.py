"""Entry point of `python -m eval.bench`; see `eval.bench.cli`."""

from eval.bench.cli import cli

if __name__ == "__main__":
    cli()
