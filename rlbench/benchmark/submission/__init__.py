"""A submission: results in one file that others can verify (docs/reference/submission.md).

`document` is the file. `collect` makes it from a results folder, `current` refuses results of other
clips or code. `content_checks` judges the file by itself, `machine_checks` by what is installed
here, `score_checks` by other scores and by measuring cells again.
"""
