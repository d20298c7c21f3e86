"""The floor page as HTML, in parts that are refreshed one by one."""

from urllib.parse import quote

from dashboards.icons import icon
from dashboards.intervals import CountedFraction
from dashboards.markup import Html, div, element, join, span
from dashboards.socket_states import SocketView
from dashboards.view_models import (
    FloorView,
    OperationQueue,
    OrderView,
    QueueEntry,
    StationGroup,
    StationView,
    YieldRow,
    YieldView,
)
from dashboards.words import (
    DISPOSITION_WORDS,
    OUTCOME_WORDS,
    PLACE_WORDS,
    SOCKET_STATE_WORDS,
    duration,
    interval_words,
    operation_word,
    percent,
    sentence_words,
)
from protocol.language import say


def unit_link(serial: str, class_: str = "serial") -> Html:
    """A link to the unit's page."""
    return element(
        "a",
        serial,
        href=f"/unit/{quote(serial, safe='')}",
        class_=class_,
        style=f"--characters:{max(len(serial), 6)}",
    )


def panel(title: str, *content: str, class_: str = "") -> Html:
    """A titled panel of the side column."""
    return element("section", element("h2", title), *content, class_=f"panel {class_}".strip())


def quiet(words: str) -> Html:
    """A line that says that there is nothing."""
    return element("p", words, class_="quiet")


def key_figures(view: FloorView, language: str) -> Html:
    """The strip on top: the order, time left, rolled and final yield."""
    yields = view.yields
    rolled_note = say("of units alone {fraction}", language=language, fraction=percent(yields.rty_unit))
    final_note = (
        say(
            "{successes} shipped of {trials} finished",
            language=language,
            successes=yields.final.successes,
            trials=yields.final.trials,
        )
        if yields.final.trials
        else say("no unit finished yet", language=language)
    )
    return div(
        "figures",
        _order_figure(view.order, language),
        _figure(say("Time left", language=language), *_time_left(view.order, language)),
        _figure(say("Rolled throughput yield", language=language), percent(yields.rty), rolled_note),
        _figure(say("Final yield", language=language), percent(yields.final.fraction), final_note),
    )


def _figure(title: str, value: str, note: str = "") -> Html:
    return div("figure", span("title", title), span("value", value), span("note", note))


def _time_left(order: OrderView, language: str) -> tuple[str, str]:
    if order.finished and order.units:
        return say("Finished", language=language), say("all units have left the line", language=language)
    if order.units == 0:
        return "–", say("no unit ordered yet", language=language)
    if order.remaining_s is None:
        return "–", say("known after the first units", language=language)
    return "≈ " + duration(order.remaining_s, language), say("at the present pace", language=language)


def _order_figure(order: OrderView, language: str) -> Html:
    parts = (
        ("shipped", say("shipped", language=language), order.shipped),
        ("fallen", say("not shipped", language=language), order.fallen),
        ("working", say("at stations", language=language), order.at_stations),
        ("waiting", say("waiting", language=language), order.waiting),
    )
    bar = [div(f"part {name}", style=f"flex-grow:{count}") for name, _, count in parts if count]
    legend = [
        span("entry", span(f"swatch {name}", aria_hidden="true"), element("b", str(count)), f" {word}")
        for name, word, count in parts
    ]
    return div(
        "figure order",
        span("title", say("Units done", language=language)),
        span("value", f"{order.done}", span("of", f" / {order.units}")),
        div("order-bar", *bar),
        div("legend", *legend),
    )


def group_heading(group: StationGroup, language: str) -> Html:
    """What these stations do, and how many of their sockets are at work."""
    names = " + ".join(operation_word(operation, language) for operation in group.operations)
    places = [PLACE_WORDS[operation] for operation in group.operations if operation in PLACE_WORDS]
    place = f" · {say(places[0], language=language)}" if places else ""
    busy = say(
        "{busy} of {sockets} sockets at work",
        language=language,
        busy=group.sockets_at_work,
        sockets=group.sockets,
    )
    return join((element("h2", names, span("place", place)), span("busy", busy)))


def station_card(station: StationView, language: str) -> Html:
    """A station with its sockets."""
    header = [span("name", station.station)]
    if station.state == "silent":
        words = say(
            "silent for {duration}", language=language, duration=duration(station.silent_for_s, language)
        )
        header.append(span("badge silent", icon("silent"), words))
    elif station.state == "refused":
        header.append(span("badge refused", icon("refused"), say("refused", language=language)))
    elif station.first_pass.trials:
        header.append(_station_first_pass(station.first_pass, language))
    sockets = [_socket_tile(station.station, socket, language) for socket in station.sockets]
    return element(
        "article",
        element("header", *header),
        div("sockets", *sockets),
        class_=f"station {station.state}",
        data_station=station.station,
    )


def _station_first_pass(first_pass: CountedFraction, language: str) -> Html:
    words = say("First-pass yield of this station:", language=language)
    return span(
        "first-pass",
        span("what", say("FPY", language=language), " "),
        f"{first_pass.successes}/{first_pass.trials}",
        title=f"{words} {percent(first_pass.fraction)}, {interval_words(first_pass, language)}",
    )


def _socket_tile(station: str, socket: SocketView, language: str) -> Html:
    state_word = (
        OUTCOME_WORDS[socket.outcome.value]
        if socket.state == "not_judged" and socket.outcome is not None
        else SOCKET_STATE_WORDS[socket.state]
    )
    state = span("state", icon(socket.state), span("word", say(state_word, language=language)))
    serial = unit_link(socket.serial) if socket.serial else span("serial none", "–")
    return div(
        f"socket {socket.state}",
        div("top", span("name", socket.socket), state),
        serial,
        *_socket_detail(socket, language),
        *_notice(socket, language),
        data_station=station,
        data_socket=socket.socket,
        data_state=socket.state,
    )


def _socket_detail(socket: SocketView, language: str) -> list[Html]:
    if socket.state == "testing":
        step = socket.step or say("starting", language=language)
        return [div("detail step", step, title=step), _step_progress(socket, language)]
    if socket.state in ("passed", "failed", "not_judged") and socket.seconds is not None:
        ago = say("{duration} ago", language=language, duration=duration(socket.seconds, language))
        return [div("detail", ago)]
    if socket.operation:
        return [div("detail", operation_word(socket.operation, language))]
    return []


def _notice(socket: SocketView, language: str) -> list[Html]:
    if not socket.notice:
        return []
    words = say("station alarm: {alarm}", language=language, alarm=socket.notice)
    return [div("notice", icon("alarm"), words, title=words)]


def _step_progress(socket: SocketView, language: str) -> Html:
    """The step under way counts from one: 'step 1 of 5' has nothing done yet."""
    total = socket.steps_total
    count = [span("count", f"{min(socket.steps_done + 1, total)}/{total}")] if total else []
    share = 100 * min(socket.steps_done / total, 1) if total else 0
    elapsed = [] if socket.seconds is None else [span("elapsed", duration(socket.seconds, language))]
    return div("progress", *count, div("track", div("done", style=f"width:{share:.0f}%")), *elapsed)


def queue_panel(queues: tuple[OperationQueue, ...], language: str) -> Html:
    """Who waits, for which operation, at which place and what for."""
    blocks = [_queue_block(queue, language) for queue in queues]
    return panel(say("Queue", language=language), *blocks or [quiet(say("nothing waits", language=language))])


def _queue_block(queue: OperationQueue, language: str) -> Html:
    heading = element(
        "h3",
        operation_word(queue.operation, language),
        span("count", str(queue.length)),
        class_="queue-title",
    )
    if not queue.length:
        return div("queue", heading, quiet(say("nobody waits", language=language)))
    entries = [_queue_entry(entry, language) for entry in queue.entries]
    more = (
        [quiet(say("and {count} more", language=language, count=queue.not_shown))] if queue.not_shown else []
    )
    return div("queue", heading, element("ol", *entries), *more)


def _queue_entry(entry: QueueEntry, language: str) -> Html:
    retest = [span("badge retest", say("Retest", language=language))] if entry.is_retest else []
    why = sentence_words(entry.waits_for, language)
    return element(
        "li",
        span("position", "–" if entry.position is None else str(entry.position)),
        unit_link(entry.serial),
        *retest,
        span("why", why, title=why),
    )


def yield_panel(yields: YieldView, language: str) -> Html:
    """First-pass yield of each operation in both conventions, with its 95 % interval."""
    rows = [_yield_block(row, language) for row in yields.operations]
    return panel(
        say("First-pass yield", language=language),
        *rows or [quiet(say("no first attempt yet", language=language))],
    )


def _yield_block(row: YieldRow, language: str) -> Html:
    return div(
        "yield",
        element("h3", operation_word(row.operation, language)),
        _yield_line(say("all first attempts", language=language), row.first_pass, language),
        _yield_line(say("faults of units alone", language=language), row.first_pass_units, language),
    )


def _yield_line(name: str, counted: CountedFraction, language: str) -> Html:
    if counted.low is None or counted.high is None or counted.fraction is None:
        bar = div("interval")
    else:
        low, high, at = (100 * value for value in (counted.low, counted.high, counted.fraction))
        bar = div(
            "interval",
            div("range", style=f"left:{low:.1f}%;width:{high - low:.1f}%"),
            div("point", style=f"left:{at:.1f}%"),
        )
    return div(
        "yield-line",
        span("name", name),
        span("value", percent(counted.fraction)),
        bar,
        span("note", interval_words(counted, language)),
    )


def alarm_panel(view: FloorView, language: str) -> Html:
    """Alarms, newest first."""
    if not view.alarms:
        return panel(say("Alarms", language=language), quiet(say("no alarm", language=language)))
    entries = [
        element(
            "li",
            icon("alarm"),
            div(
                "what",
                element("b", alarm.subject),
                " ",
                sentence_words(alarm.sentence, language),
                span(
                    "note",
                    f"{alarm.alarm} · "
                    + say("{duration} ago", language=language, duration=duration(alarm.age_s, language)),
                ),
            ),
        )
        for alarm in view.alarms
    ]
    more = (
        [quiet(say("and {count} more", language=language, count=view.alarms_not_shown))]
        if view.alarms_not_shown
        else []
    )
    return panel(say("Alarms", language=language), element("ul", *entries), *more, class_="alarms raised")


def fallen_panel(view: FloorView, language: str) -> Html:
    """Units that left the line without being shipped."""
    title = say("Not shipped", language=language)
    if not view.fallen:
        return panel(title, quiet(say("no unit", language=language)))
    entries = [
        element(
            "li",
            unit_link(unit.serial),
            span(
                f"badge {unit.disposition.value.lower()}",
                say(DISPOSITION_WORDS[unit.disposition.value], language=language),
            ),
            span("why", say("{count} attempts", language=language, count=unit.attempts)),
        )
        for unit in view.fallen
    ]
    more = (
        [quiet(say("and {count} more", language=language, count=view.fallen_not_shown))]
        if view.fallen_not_shown
        else []
    )
    return panel(title, element("ul", *entries), *more, class_="fallen")


def records_line(view: FloorView, language: str) -> Html:
    """What the coordinator has kept, in one quiet line."""
    words = say(
        "{recorded} attempts recorded · {set_aside} set aside · {duplicates} duplicates ignored",
        language=language,
        recorded=view.attempts_recorded,
        set_aside=view.records_set_aside,
        duplicates=view.duplicates_ignored,
    )
    return element("p", words, class_="records")
