"""The parts that trials share: how one is run and judged, statistics, and the page."""
