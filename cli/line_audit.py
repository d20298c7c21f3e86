"""After a run: read spools and database, ask the emulator for the truth, and make the summary."""

from collections.abc import Sequence
from typing import Any

from sqlalchemy import create_engine, select

from cli.line_layout import LineLayout
from cli.line_summary import KeptRecord, Ledger, Truth, summarise
from coordinator.store.tables import ATTEMPTS
from dut_emulator.products.gnc_module.population import truth_table
from protocol.line_views import LineStatus
from protocol.outcomes import Outcome
from protocol.routes import GNC_MODULE_ROUTE
from stations.sequencing.step_registry import bundled_plans
from stations.spool import leases_ended, records_made


def audited_summary(
    layout: LineLayout, status: LineStatus, serials: Sequence[str], wall_s: float
) -> tuple[dict[str, Any], dict[str, Truth]]:
    """The summary of a run whose processes have stopped, and the truth of its units by serial."""
    truths = [
        Truth(serial=row["serial"], category=row["category"], defect=row["defect"])
        for row in truth_table(layout.seed, serials)
    ]
    operations = {operation.name for operation in GNC_MODULE_ROUTE.operations}
    plans = [plan for name, plan in bundled_plans().items() if name in operations]
    summary = summarise(status, truths, _ledger(layout), GNC_MODULE_ROUTE, plans, wall_s)
    return summary, {truth.serial: truth for truth in truths}


def _ledger(layout: LineLayout) -> Ledger:
    columns = ATTEMPTS.c
    question = select(
        columns.attempt_id,
        columns.station,
        columns.fence,
        columns.serial,
        columns.operation,
        columns.outcome,
        columns.set_aside,
    )
    engine = create_engine(layout.database_url)
    try:
        with engine.connect() as connection:
            rows = connection.execute(question).all()
    finally:
        engine.dispose()
    return Ledger(
        made={station: records_made(layout.spool(station)) for station in layout.stations()},
        ended={station: leases_ended(layout.spool(station)) for station in layout.stations()},
        kept=[
            KeptRecord(
                attempt_id=row.attempt_id,
                station=row.station,
                fence=row.fence,
                serial=row.serial,
                operation=row.operation,
                outcome=Outcome(row.outcome),
                counted=not row.set_aside,
            )
            for row in rows
        ],
    )
