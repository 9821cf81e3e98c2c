//! Records: the log and the audit.

use super::{given, maybe};
use crate::table::{Column, Kind, Table};

const LOG_COLUMNS: &[Column] = &[
    given("datetime", Kind::Stamp, "when the line was written"),
    given("boot_id", Kind::Text, "incarnation of the node"),
    given("seq", Kind::Int, "number of the sample"),
    given("node", Kind::Text, "the node, such as `device/main`"),
    given("level", Kind::Text, "`error`, `warning` or `info`"),
    given("message", Kind::Text, "the line"),
    given("target", Kind::Text, "the module that wrote it"),
    given("node_telescope", Kind::Text, "the telescope of the node; `shared` for a node of the site's devices")
        .read_by("telescope"),
];

/// Each line of a node's log.
pub(super) const LOG: Table = Table {
    name: "log",
    about: "each line of a node's log",
    columns: LOG_COLUMNS,
    key: 4,
    group: 0,
    prefer: None,
    from: "log WHERE datetime >= :from AND datetime < :to AND telescope IN (:telescope, 'shared')",
    next: Some("SELECT min(datetime) FROM log WHERE datetime >= :from AND telescope IN (:telescope, 'shared')"),
    insert: None,
    into: "log",
    owner: None,
    before: None,
};

const AUDIT_COLUMNS: &[Column] = &[
    given("node", Kind::Text, "the node that wrote it, such as `device/callisto/main`"),
    given("chain", Kind::Text, "the chain of the record"),
    given("number", Kind::Int, "its number there; -1 where it cannot be read"),
    given("sha256", Kind::Text, "of the record"),
    maybe("datetime", Kind::Stamp, "when it was written; none where it cannot be read"),
    given("who", Kind::Text, "the person or node that asked"),
    given("device", Kind::Text, "the device; empty for an order"),
    given("verb", Kind::Text, "the word of the command or order"),
    maybe("token", Kind::Int, "fencing token"),
    given("outcome", Kind::Text, "the outcome"),
    given("line", Kind::Text, "the whole record, as its node wrote it"),
    maybe("fault", Kind::Text, "the fault of the record, or of its place in the chain"),
    given("stored_order", Kind::Int, "order in which the archive stored records").read_by("rowid"),
];

/// The records are gathered first, and put into the table in the order of their storing at the end.
pub(crate) const GATHER_AUDIT: &str = "CREATE TEMP TABLE gathered AS SELECT *, 0 AS stored_order FROM audit WHERE 0;
    CREATE UNIQUE INDEX temp.gathered_once ON gathered (node, chain, number, sha256);";
/// The order of their storing is that of one database where each place is taken once and no chain goes back. Rows of two
/// databases, of which the second one began anew, have no such order: they are put in the order of time, and each chain in its
/// own; a record without a time comes after the one that was stored before it.
pub(crate) const ORDER_AUDIT: &str = "CREATE TEMP TABLE placed AS SELECT rowid AS place, max(ifnull(datetime, ifnull(
        (SELECT datetime FROM gathered AS before WHERE before.stored_order < gathered.stored_order AND datetime IS NOT NULL
            ORDER BY before.stored_order DESC LIMIT 1), '')))
        OVER (PARTITION BY node, chain, number < 0 ORDER BY number, stored_order) AS at FROM gathered;
    UPDATE placed SET at = '' WHERE (SELECT count(*) = count(DISTINCT stored_order) FROM gathered) AND NOT EXISTS
        (SELECT 1 FROM (SELECT number, lag(number) OVER (PARTITION BY node, chain ORDER BY stored_order) AS last FROM gathered
            WHERE number >= 0 AND fault IS NULL) WHERE number < last);
    INSERT INTO audit SELECT node, chain, gathered.number, datetime, who, device, verb, token, outcome, line, sha256, fault
        FROM gathered JOIN placed ON place = gathered.rowid
        ORDER BY at, iif(at = '', stored_order, 0), node, chain, gathered.number, stored_order;
    DROP TABLE gathered; DROP TABLE placed;";

/// Each order, command and movement that was recorded.
pub(super) const AUDIT: Table = Table {
    name: "audit",
    about: "each order, command and movement that was recorded",
    columns: AUDIT_COLUMNS,
    key: 4,
    group: 0,
    prefer: None,
    from: "audit WHERE (instr(node, '/' || :telescope || '/') > 0 OR instr(node, '/shared/') > 0)
        AND ((datetime >= :from AND datetime < :to) OR (datetime IS NULL AND rowid IN
        (SELECT row FROM (SELECT a.rowid AS row, ifnull(
            (SELECT b.datetime FROM audit AS b WHERE b.rowid < a.rowid AND b.datetime IS NOT NULL ORDER BY b.rowid DESC LIMIT 1),
            '1970-01-01 00:00:00.000000') AS at FROM audit AS a WHERE a.datetime IS NULL) WHERE at >= :from AND at < :to)))",
    next: Some("SELECT min(at) FROM (SELECT min(datetime) AS at FROM audit WHERE datetime >= :from
                AND (instr(node, '/' || :telescope || '/') > 0 OR instr(node, '/shared/') > 0)
            UNION ALL SELECT '1970-01-01 00:00:00.000000' FROM audit AS a WHERE datetime IS NULL
                AND :from <= '1970-01-01 00:00:00.000000' AND NOT EXISTS
                (SELECT 1 FROM audit AS b WHERE b.rowid < a.rowid AND b.datetime IS NOT NULL))"),
    insert: Some(
        "INSERT OR REPLACE INTO gathered (node, chain, number, sha256, datetime, who, device, verb, token, outcome, line,
            fault, stored_order) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13)",
    ),
    into: "audit",
    owner: None,
    before: None,
};
