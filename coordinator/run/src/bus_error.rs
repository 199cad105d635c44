//! SIGBUS where shared memory is full.
//!
//! Channels get all their pages when they are made, but iceoryx2 writes into the first of them a moment before they can be
//! reserved. Whoever fills shared memory in that moment ends this process by SIGBUS, without a word. So a
//! handler says what was missing, and ends with the exit code for it. Children die with this process, and the
//! janitor removes its shared memory; what children die of is told by [`Cause`](crate::supervisor::Cause).

#![expect(
    unsafe_code,
    reason = "a handler is safe if it calls nothing but what signal-safety(7) allows, which no type can say"
)]

use channels::SHARED_MEMORY;
use nix::sys::signal::{SaFlags, SigAction, SigHandler, SigSet, Signal, raise, sigaction};
use proto::ExitCode;
use rustix::stdio::stderr;

use crate::preflight::{MAKE_ROOM, shared_memory_is_full};

/// Reports SIGBUS from now on, if shared memory is full then.
pub fn report() -> std::io::Result<()> {
    // The default comes back when the handler is called.
    let handler = SigHandler::Handler(handle);
    let action = SigAction::new(handler, SaFlags::SA_RESETHAND, SigSet::empty());
    // SAFETY: `handle` allocates nothing, takes no lock and returns to nothing that it has changed.
    unsafe { sigaction(Signal::SIGBUS, &action) }?;
    Ok(())
}

/// System calls alone, whose arguments are constants or lie on the stack.
extern "C" fn handle(_signal: i32) {
    if !shared_memory_is_full() {
        // Something else, of which the process dies as it would have.
        let _ = raise(Signal::SIGBUS);
        return;
    }
    for part in
        ["error: shared memory is full: ", SHARED_MEMORY, " had no page left; ", MAKE_ROOM, "\n"]
    {
        let _ = rustix::io::write(stderr(), part.as_bytes());
    }
    // SAFETY: it runs nothing of this program any more.
    unsafe { nix::libc::_exit(ExitCode::Environment as i32) }
}
