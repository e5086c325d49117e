"""The cleaning pipeline and everything around it; ``cleaner`` lists its stages."""
