"""How property tests run everywhere: the same examples each time, and no limit of wall time, for machines are noisy.

``pytest --hypothesis-profile=explore`` looks for new ones.
"""

from hypothesis import settings

settings.register_profile("steady", derandomize=True, deadline=None)
settings.register_profile("explore", max_examples=1000, deadline=None)
settings.load_profile("steady")
