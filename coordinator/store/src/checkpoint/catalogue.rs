//! The index of a store as an SQLite database, for users' own tools.
//!
//! ```sql
//! select c.name, c.score from checkpoints c join tags t on t.name = c.name where t.tag = 'best';
//! ```
//!
//! It is written after every change of the store and is never the truth: what is missing, damaged,
//! of another version or at odds with the directories is written anew from the manifests.

use std::fs::{self, Permissions};
use std::io::ErrorKind;
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

use rusqlite::{Connection, params};

use super::entry::Entry;
use super::error::CheckpointError;
use super::name::Name;
use crate::owned_files;

/// Name of the database.
pub const CATALOGUE: &str = "catalogue.sqlite";
/// `user_version` of the tables below.
const VERSION: i64 = 1;
/// How long another program's transaction is waited for.
const PATIENCE: Duration = Duration::from_secs(5);

const SCHEMA: &str = "
create table checkpoints (
    name      text primary key,
    kind      text not null,    -- training, policy, composed
    iteration integer not null,
    env_steps integer not null,
    digest    text not null,
    created   integer not null, -- seconds since 1970
    bytes     integer not null,
    pinned    integer not null, -- 0, 1
    milestone integer not null, -- 0, 1
    score     real              -- the smaller, the better
) strict;
create table tags (
    tag  text not null,
    name text not null references checkpoints (name) on delete cascade,
    primary key (tag, name)
) strict;
";

/// A checkpoint as the tables hold it.
#[derive(Debug, Clone, PartialEq)]
struct Row {
    name: String,
    kind: String,
    iteration: i64,
    env_steps: i64,
    digest: String,
    created: i64,
    bytes: i64,
    pinned: bool,
    milestone: bool,
    score: Option<f64>,
    tags: Vec<String>,
}

impl Row {
    fn of(entry: &Entry) -> Self {
        // SQLite counts to 2⁶³ − 1; a manifest that claims more is no reason to fail.
        let integer = |count: u64| i64::try_from(count).unwrap_or(i64::MAX);
        let mut tags: Vec<String> = entry.labels.tags.iter().map(ToString::to_string).collect();
        tags.sort();
        tags.dedup();
        Self {
            name: entry.name.to_string(),
            kind: entry.kind.as_str().to_owned(),
            iteration: integer(entry.iteration),
            env_steps: integer(entry.env_steps),
            digest: entry.digest.to_string(),
            created: integer(entry.created_unix_s),
            bytes: integer(entry.bytes),
            pinned: entry.labels.pinned,
            milestone: entry.labels.milestone,
            score: entry.labels.score.as_ref().map(|score| score.value),
            tags,
        }
    }
}

/// Brings the catalogue of the store in `root` up to date with `entries`. `touched` has just been
/// changed; a difference in any other row means that somebody changed the directories by hand,
/// which is worth a warning.
pub(super) fn refresh(
    root: &Path,
    entries: &[Entry],
    touched: &[&Name],
) -> Result<(), CheckpointError> {
    let path = root.join(CATALOGUE);
    if !path.exists() {
        return rebuild(root, entries);
    }
    let wanted = rows(entries);
    let outcome = open(&path).and_then(|mut database| {
        let there = read(&database)?;
        if there == wanted {
            return Ok(());
        }
        let untouched = |rows: &[Row]| -> Vec<Row> {
            let touched = |row: &&Row| !touched.iter().any(|name| name.as_str() == row.name);
            // The tag `best` moves between rows that nobody touched.
            let plain = |row: &Row| Row { tags: Vec::new(), ..row.clone() };
            rows.iter().filter(touched).map(plain).collect()
        };
        if untouched(&there) != untouched(&wanted) {
            tracing::warn!(
                catalogue = %path.display(),
                "the catalogue disagrees with the directories and is rebuilt"
            );
        }
        write(&mut database, &wanted)
    });
    outcome.or_else(|reason| {
        tracing::warn!(catalogue = %path.display(), %reason, "the catalogue is rebuilt");
        rebuild(root, entries)
    })
}

/// Writes the catalogue of the store in `root` anew.
pub(super) fn rebuild(root: &Path, entries: &[Entry]) -> Result<(), CheckpointError> {
    let path = root.join(CATALOGUE);
    for part in parts(&path) {
        match fs::remove_file(&part) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                return Err(CheckpointError::io(&part, "remove")(error));
            }
            _ => {}
        }
    }
    create(&path).and_then(|mut database| write(&mut database, &rows(entries))).map_err(|reason| {
        CheckpointError::Io { path, action: "write", source: std::io::Error::other(reason) }
    })
}

/// Why the database is not used as it is.
type Reason = String;

#[expect(clippy::needless_pass_by_value, reason = "the form that `map_err` wants")]
fn sql(error: rusqlite::Error) -> Reason {
    error.to_string()
}

fn rows(entries: &[Entry]) -> Vec<Row> {
    let mut rows: Vec<Row> = entries.iter().map(Row::of).collect();
    rows.sort_by(|a, b| a.name.cmp(&b.name));
    rows
}

/// Makes the database, or what there is of it, its user's alone: whoever may open it may lock it, too. The files
/// that SQLite puts beside it get its rights.
fn keep_private(path: &Path) -> Result<(), Reason> {
    let made = fs::File::options().write(true).create_new(true).mode(owned_files::MODE).open(path);
    match made {
        Ok(_) => return Ok(()),
        Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
        Err(error) => return Err(error.to_string()),
    }
    for part in parts(path) {
        // Not opened: SQLite's own locks on a file end when this process closes it anywhere.
        let Ok(there) = part.symlink_metadata() else { continue };
        if there.is_file() && there.uid() == owned_files::user() && there.mode() & 0o077 != 0 {
            fs::set_permissions(&part, Permissions::from_mode(owned_files::MODE))
                .map_err(|error| error.to_string())?;
        }
    }
    Ok(())
}

/// The database and the files that SQLite puts beside it.
fn parts(path: &Path) -> [PathBuf; 4] {
    ["", "-wal", "-shm", "-journal"].map(|suffix| {
        let mut part = path.as_os_str().to_owned();
        part.push(suffix);
        part.into()
    })
}

fn connect(path: &Path) -> Result<Connection, Reason> {
    keep_private(path)?;
    let database = Connection::open(path).map_err(sql)?;
    database.busy_timeout(PATIENCE).map_err(sql)?;
    database.pragma_update(None, "journal_mode", "wal").map_err(sql)?;
    // A power cut may lose the last rows; the next change finds that out.
    database.pragma_update(None, "synchronous", "normal").map_err(sql)?;
    database.pragma_update(None, "foreign_keys", true).map_err(sql)?;
    Ok(database)
}

fn create(path: &Path) -> Result<Connection, Reason> {
    let database = connect(path)?;
    database.execute_batch(SCHEMA).map_err(sql)?;
    database.pragma_update(None, "user_version", VERSION).map_err(sql)?;
    Ok(database)
}

/// Opens a database and checks that it is whole and of this version.
fn open(path: &Path) -> Result<Connection, Reason> {
    let database = connect(path)?;
    let version: i64 =
        database.pragma_query_value(None, "user_version", |row| row.get(0)).map_err(sql)?;
    if version != VERSION {
        return Err(format!("it has version {version}, this program writes {VERSION}"));
    }
    let check: String =
        database.pragma_query_value(None, "quick_check", |row| row.get(0)).map_err(sql)?;
    if check == "ok" { Ok(database) } else { Err(format!("it is damaged: {check}")) }
}

fn read(database: &Connection) -> Result<Vec<Row>, Reason> {
    let mut statement = database
        .prepare(
            "select name, kind, iteration, env_steps, digest, created, bytes, pinned, milestone, \
             score from checkpoints order by name",
        )
        .map_err(sql)?;
    let mut rows = statement
        .query_map([], |row| {
            Ok(Row {
                name: row.get(0)?,
                kind: row.get(1)?,
                iteration: row.get(2)?,
                env_steps: row.get(3)?,
                digest: row.get(4)?,
                created: row.get(5)?,
                bytes: row.get(6)?,
                pinned: row.get(7)?,
                milestone: row.get(8)?,
                score: row.get(9)?,
                tags: Vec::new(),
            })
        })
        .and_then(Iterator::collect::<Result<Vec<_>, _>>)
        .map_err(sql)?;
    let mut tags =
        database.prepare("select tag from tags where name = ? order by tag").map_err(sql)?;
    for row in &mut rows {
        row.tags = tags
            .query_map([&row.name], |tag| tag.get(0))
            .and_then(Iterator::collect)
            .map_err(sql)?;
    }
    Ok(rows)
}

/// Replaces all rows in one transaction.
fn write(database: &mut Connection, rows: &[Row]) -> Result<(), Reason> {
    let replace = |database: &mut Connection| {
        let transaction = database.transaction()?;
        transaction.execute("delete from tags", [])?;
        transaction.execute("delete from checkpoints", [])?;
        for row in rows {
            transaction.execute(
                "insert into checkpoints values (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
                params![
                    row.name,
                    row.kind,
                    row.iteration,
                    row.env_steps,
                    row.digest,
                    row.created,
                    row.bytes,
                    row.pinned,
                    row.milestone,
                    row.score,
                ],
            )?;
            for tag in &row.tags {
                transaction.execute("insert into tags values (?, ?)", params![tag, row.name])?;
            }
        }
        transaction.commit()
    };
    replace(database).map_err(sql)
}
