"""One frame of D1 and of D2: the cycle of each, what it is given, and the records of what it
decided.

Whatever runs the method (a flight, its replay, films, Monte Carlo, trials) runs it through these
two.
"""
