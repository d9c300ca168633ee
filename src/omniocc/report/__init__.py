"""Tables and pages made from the runs' own files.

`runs` reads what every run recorded; `rows` and `selection` choose the runs of each row; `tables/`, `plots/`, `frames`
and `dataset/` make the parts; `sweep` holds them together; `chapters` writes the tables; `page` with `templates/` makes
the page. `wandb/` has the dashboard and the upload. Helper: `html`.
"""
