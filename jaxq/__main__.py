"""``python -m jaxq``."""

from jaxq.cli import main

raise SystemExit(main())
