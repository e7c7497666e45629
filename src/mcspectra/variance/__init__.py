"""Variance of estimators: measured, predicted term by term, exact, and against n."""
