# pyright: strict
"""A few line icons, drawn here: no icon font, no request. Shape tells the state as well as colour."""

from dashboards.markup import Html

_PATHS = {
    "free": '<circle cx="12" cy="12" r="8" stroke-dasharray="3 3.3"/>',
    "testing": '<path d="M8 5.5v13l10.5-6.5z"/>',
    "recording": '<path d="M12 4v10m-4-4 4 4 4-4M5 19h14"/>',
    "passed": '<path d="m5 12.5 5 5 9.5-11"/>',
    "failed": '<path d="m6 6 12 12M18 6 6 18"/>',
    "not_judged": '<path d="M12 4 2.8 20h18.4zM12 10v5m0 2.4v.4"/>',
    "silent": '<path d="M4 4l16 16M9.5 14.5a4 4 0 0 1 5 0M6 11a9 9 0 0 1 3-2m6 0a9 9 0 0 1 3 2M12 18.5v.3"/>',
    "refused": '<circle cx="12" cy="12" r="8.5"/><path d="m6 18 12-12"/>',
    "alarm": '<path d="M6 17V11a6 6 0 0 1 12 0v6l1.5 2h-15zM10 21.5h4"/>',
    "sun": (
        '<circle cx="12" cy="12" r="4"/><path d="M12 3v2m0 14v2M3 12h2m14 0h2M5.6 5.6 7 7'
        'm10 10 1.4 1.4M18.4 5.6 17 7M7 17l-1.4 1.4"/>'
    ),
    "moon": '<path d="M19.5 14A8 8 0 0 1 10 4.5a8 8 0 1 0 9.5 9.5z"/>',
    "auto": '<circle cx="12" cy="12" r="8"/><path d="M12 4a8 8 0 0 1 0 16z" fill="currentColor"/>',
    "search": '<circle cx="11" cy="11" r="6"/><path d="m15.5 15.5 5 5"/>',
    "loom": '<path d="M4 7h16M4 12h16M4 17h16M8 4v16M12 4v16M16 4v16"/>',
    "back": '<path d="M19 12H5m6-6-6 6 6 6"/>',
}

ICON_NAMES = frozenset(_PATHS)


def icon(name: str) -> Html:
    """The icon as inline SVG, hidden from screen readers: the word beside it says the same."""
    return Html(f'<svg class="icon" viewBox="0 0 24 24" aria-hidden="true">{_PATHS[name]}</svg>')
