"""``python -m jaxq``, and the ``jaxq`` command."""

from __future__ import annotations


def main() -> int:
    """Runs the command line; Ctrl-C is quiet from the first import on."""
    try:
        from jaxq import cli

        return cli.main()
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    raise SystemExit(main())
