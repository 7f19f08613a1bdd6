"""gymnax's calls on our environments, and gymnax's environments as ours. Imports no gymnax.

Lange, *gymnax: A JAX-based Reinforcement Learning Environment Library*, 2022.
"""

from jaxq.interop.gymnax.style import GymnaxStyle
from jaxq.interop.gymnax.theirs import from_gymnax

__all__ = ["GymnaxStyle", "from_gymnax"]
