//! What other users of the machine can open in a store, and so lock.

use std::fs::Permissions;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
use std::sync::{Arc, Mutex};

use super::*;
use crate::checkpoint::disk::Disk;
use crate::checkpoint::guard::WRITING;

fn mode(path: &Path) -> u32 {
    path.metadata().unwrap_or_else(|error| panic!("{}: {error}", path.display())).mode() & 0o777
}

#[test]
fn nobody_else_can_open_what_is_being_written() {
    let (_dir, mut store) = store();
    let seen = Arc::new(Mutex::new(Vec::new()));
    let modes = Arc::clone(&seen);
    store.disk = Disk::observed(Arc::new(move |step| {
        let above = step.path.parent().expect("it has one");
        if step.action == "write" && above.to_string_lossy().contains(WRITING) {
            modes.lock().expect("whole").push(mode(above));
        }
        Ok(())
    }));
    let committed = commit(&store, 1);
    let seen = seen.lock().expect("whole");
    assert!(seen.len() > 3 && seen.iter().all(|mode| *mode == 0o700), "{seen:?}");
    assert_eq!(mode(&committed), mode(store.root()), "who may enter the store reads it");
}

#[test]
fn the_catalogue_is_its_users_alone() {
    let (dir, store) = store_with(&[1]);
    let catalogue = store.root().join(CATALOGUE);
    assert_eq!(mode(&catalogue), 0o600);
    // As an earlier version has made it.
    std::fs::set_permissions(&catalogue, Permissions::from_mode(0o644)).expect("own");
    commit(&store, 2);
    assert_eq!(mode(&catalogue), 0o600);
    // What a link leads to is not the store's.
    let elsewhere = dir.path().join("elsewhere");
    std::fs::rename(&catalogue, &elsewhere).expect("renames");
    std::fs::set_permissions(&elsewhere, Permissions::from_mode(0o644)).expect("own");
    std::os::unix::fs::symlink(&elsewhere, &catalogue).expect("a link");
    commit(&store, 3);
    assert_eq!(mode(&elsewhere), 0o644);
}

#[test]
fn what_a_killed_upload_has_left_is_swept() {
    let (_dir, store) = store_with(&[1]);
    let left = store.root().join(format!("{UPLOAD}4711-0"));
    std::fs::write(&left, "half an archive").expect("writable");
    store.retain(&Retention { latest: 1, every: 0, best: false }).expect("retains");
    assert!(!left.exists());
    assert_eq!(contents(store.root()), [nth(1).as_str()]);
}
