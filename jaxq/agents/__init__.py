"""Learners: factories from static structure and traced numbers to ``jaxq.types.Agent``. They know no environment."""
