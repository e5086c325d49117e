"""The cleaning pipeline and everything around it; ``cleaner`` lists its stages.

``import kinefilter`` offers what most users need.
"""
