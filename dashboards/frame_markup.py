"""What frames every page: header, connection, and what is said when there is nothing to show."""

from urllib.parse import quote

from dashboards.icons import icon
from dashboards.markup import Html, div, element, span
from dashboards.read_model import Connection, Snapshot
from dashboards.words import duration
from protocol.language import say

_NEXT_THEME = {"auto": "light", "light": "dark", "dark": "auto"}
_THEME_ICONS = {"auto": "auto", "light": "sun", "dark": "moon"}
_THEME_WORDS = {"auto": "Theme of the system", "light": "Light theme", "dark": "Dark theme"}


def header_bar(line: str, language: str, theme: str, back: str, *, is_floor: bool) -> Html:
    """Name, line, search for a serial, language and theme. Plain links: they work without script."""
    home = element(
        "a",
        icon("loom" if is_floor else "back"),
        element("b", "Testloom"),
        span("line", line),
        href="/",
        class_="home",
        title=say("To the floor", language=language),
    )
    search_words = say("Serial number", language=language)
    search = element(
        "form",
        icon("search"),
        element(
            "input",
            name="serial",
            type="search",
            placeholder=search_words,
            aria_label=search_words,
            maxlength=64,
            autocomplete="off",
            spellcheck="false",
        ),
        action="/unit",
        method="get",
        class_="search",
        role="search",
    )
    encoded_back = quote(back, safe="")
    other, other_word = ("en", "English") if language == "zh" else ("zh", "中文")
    to_language = element("a", other_word, href=f"/language/{other}?back={encoded_back}", class_="switch")
    theme_words = say(_THEME_WORDS[theme], language=language)
    to_theme = element(
        "a",
        icon(_THEME_ICONS[theme]),
        href=f"/theme/{_NEXT_THEME[theme]}?back={encoded_back}",
        class_="switch theme",
        title=theme_words,
        aria_label=theme_words,
    )
    return element("nav", home, search, to_language, to_theme)


def connection_pill(connection: Connection, language: str) -> Html:
    """One word on the connection to the coordinator."""
    words = {
        "live": say("Live", language=language),
        "connecting": say("Connecting", language=language),
        "away": say("Coordinator away", language=language),
    }
    return span(f"pill {connection.state}", span("dot"), words[connection.state], role="status")


def away_banner(snapshot: Snapshot, language: str) -> Html:
    """Says that the coordinator is away, for how long, and what that means for what is shown."""
    away = duration(snapshot.connection.away_for_s, language)
    headline = say("The coordinator has not answered for {duration}.", language=language, duration=away)
    if snapshot.status is None:
        meaning = say("Nothing is known of the line yet.", language=language)
    else:
        meaning = say(
            "What is shown is {duration} old. Stations go on and keep their results.",
            language=language,
            duration=duration(snapshot.status_age_s, language),
        )
    again = say("This page asks again by itself.", language=language)
    return div(
        "away-banner",
        icon("silent"),
        div("words", element("b", headline), f" {meaning} {again}"),
        span("reason", say(snapshot.connection.reason, language=language)),
        role="alert",
    )


def waiting_for_line(connection: Connection, language: str) -> Html:
    """Instead of the floor as long as nothing was ever heard."""
    words = (
        say("Waiting for the coordinator. Start it with `testloom coordinator`.", language=language)
        if connection.state == "away"
        else say("Asking the coordinator …", language=language)
    )
    return div("empty", icon("loom"), element("p", words))


def waiting_for_unit(serial: str, language: str) -> Html:
    """Instead of a unit that could not be asked for yet."""
    words = say("The coordinator has not answered yet: nothing is known of this unit.", language=language)
    return div("empty", element("h1", serial), element("p", words))


def unknown_unit(serial: str, said: str, language: str) -> Html:
    """The coordinator does not know the serial."""
    return div(
        "empty unknown",
        icon("not_judged"),
        element("h1", serial),
        element("p", say("This serial is not known on the line.", language=language), class_="lead"),
        element("p", said, class_="quiet"),
        element("a", say("To the floor", language=language), href="/", class_="switch"),
    )
