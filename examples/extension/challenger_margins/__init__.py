"""An extension of challenger-bench: near misses, and one example of each kind of thing that can be added."""

OFFERS = {
    "command": {
        "margins": "challenger_margins.commands:margins_command",
        "data export csv": "challenger_margins.commands:export_csv_command",
    },
    "judge": {"margin": "challenger_margins.judge:MarginProtocol"},
    "table": {"margins": "challenger_margins.tables:margin_table"},
    "page": {"protocols margins": "challenger_margins.tables:margin_page"},
    "planner": {"easing": "challenger_margins.planner:Easing"},
    "renderer": {"outline": "challenger_margins.renderer:OutlineSource"},
    "engine": {"overshoot": "challenger_margins.engine:make_overshoot"},
    "options": {
        "planner easing": "challenger_margins.options:EasingOptions",
        "renderer outline": "challenger_margins.options:OutlineOptions",
    },
}
