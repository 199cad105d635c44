//! The simulator as a WebAssembly module: one environment that a page steps, draws and takes hold of.
//!
//! An instance of the module is one simulation. It needs nothing from outside, not even a clock, and gives the bits that the
//! native program gives.
//!
//! **How to call it.** Functions take and return numbers. What is longer goes through linear memory: [`input`] makes
//! room for bytes, which the caller writes there and the next call takes; [`describe`] says in JSON where the arrays are that
//! a page reads (see `arrays`); [`text`] is what went wrong, in words, or what [`describe`] wrote. Calls that can
//! fail return −1 then. JSON values are [`Start`](simulator::experiment::Start) and [`Event`](simulator::experiment::Event).
//!
//! A typed array over linear memory is of no use any more once memory has grown, which any call may do.
//!
//! **Panics** would be defects. They trap, and leave their words in [`text`]; the instance is of no use then.
//!
//! Nothing here needs `unsafe` but the names of the exported functions: memory that the caller writes to is a vector's, and
//! nobody else looks at it meanwhile.
#![cfg_attr(
    target_arch = "wasm32",
    expect(unsafe_code, reason = "names of exported functions, by which a page finds them")
)]

mod arrays;
mod blocks;
mod description;
mod simulation;

use std::cell::RefCell;

use simulation::Simulation;

/// Version of the exported functions and of what they read and write.
const VERSION: u32 = 3;

thread_local! {
    static INPUT: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
    static TEXT: RefCell<String> = const { RefCell::new(String::new()) };
    static SIMULATION: RefCell<Simulation> = RefCell::new(Simulation::default());
}

/// What `work` returns, or −1 and its error in the text.
fn answer(work: impl FnOnce(&mut Simulation) -> Result<u32, String>) -> i32 {
    match SIMULATION.with_borrow_mut(work) {
        Ok(number) => number as i32,
        Err(error) => {
            TEXT.set(error);
            -1
        }
    }
}

/// Takes the input.
fn take_input() -> Vec<u8> {
    INPUT.take()
}

/// Version of this interface. To be called first: it also sees to it that panics leave words.
#[cfg_attr(target_arch = "wasm32", unsafe(no_mangle))]
pub extern "C" fn version() -> u32 {
    #[cfg(target_arch = "wasm32")]
    std::panic::set_hook(Box::new(|panic| TEXT.set(panic.to_string())));
    VERSION
}

/// Makes room for `len` bytes of input and returns its address; what was there is gone.
#[cfg_attr(target_arch = "wasm32", unsafe(no_mangle))]
pub extern "C" fn input(len: u32) -> *mut u8 {
    INPUT.with_borrow_mut(|input| {
        *input = vec![0; len as usize];
        input.as_mut_ptr()
    })
}

/// Address of the text, UTF-8.
#[cfg_attr(target_arch = "wasm32", unsafe(no_mangle))]
pub extern "C" fn text() -> *const u8 {
    TEXT.with_borrow(|text| text.as_ptr())
}

/// Length of the text (bytes).
#[cfg_attr(target_arch = "wasm32", unsafe(no_mangle))]
pub extern "C" fn text_len() -> u32 {
    TEXT.with_borrow(|text| text.len() as u32)
}

/// Loads a policy: the input is `config.toml`, `robot.toml` and the actors' safetensors, one after the other. It takes the place of policy `slot`, or one of
/// its own where that is −1. Returns its slot, or −1.
///
/// The first one brings the robot and how it is integrated.
#[cfg_attr(target_arch = "wasm32", unsafe(no_mangle))]
pub extern "C" fn policy(slot: i32, config_len: u32, robot_len: u32) -> i32 {
    let input = take_input();
    let (config, robot) = (config_len as usize, robot_len as usize);
    answer(|simulation| {
        let slot = usize::try_from(slot).ok();
        simulation.policy(slot, &input, config, robot).map(|slot| slot as u32)
    })
}

/// Lets go of the policy of `slot`, also in moments that are kept: that of `successor` has its places.
/// Returns 0, or −1.
#[cfg_attr(target_arch = "wasm32", unsafe(no_mangle))]
pub extern "C" fn retire(slot: u32, successor: u32) -> i32 {
    answer(|simulation| simulation.retire(slot as usize, successor as usize).map(|()| 0))
}

/// Begins an episode as the input's JSON says. Returns 0, or −1.
#[cfg_attr(target_arch = "wasm32", unsafe(no_mangle))]
pub extern "C" fn reset() -> i32 {
    let input = take_input();
    answer(|simulation| simulation.reset(&input).map(|()| 0))
}

/// Lets happen what the input's JSON says, from the next step on. Returns 0, or −1 and nothing has changed.
#[cfg_attr(target_arch = "wasm32", unsafe(no_mangle))]
pub extern "C" fn event() -> i32 {
    let input = take_input();
    answer(|simulation| simulation.event(&input).map(|()| 0))
}

/// Plays a control step. Returns 0, or −1: then nothing goes on before a reset or an earlier snapshot.
#[cfg_attr(target_arch = "wasm32", unsafe(no_mangle))]
pub extern "C" fn step() -> i32 {
    answer(|simulation| simulation.step().map(|()| 0))
}

/// Writes a description into the text, in JSON. Returns 0, or −1.
#[cfg_attr(target_arch = "wasm32", unsafe(no_mangle))]
pub extern "C" fn describe() -> i32 {
    answer(|simulation| {
        TEXT.set(simulation.describe()?);
        Ok(0)
    })
}

/// Makes a block of a run again: the input's JSON says which, as `{"iteration": 500, "shard": 1}`, the policy of slot 0 acts, and its
/// configuration names the seed. Writes its digest and returns into the text, in JSON. Returns 0, or −1. The episode stays as it is.
#[cfg_attr(target_arch = "wasm32", unsafe(no_mangle))]
pub extern "C" fn block() -> i32 {
    let input = take_input();
    answer(|simulation| {
        TEXT.set(simulation.block(&input)?);
        Ok(0)
    })
}

/// Keeps this moment. Returns its number, counted from 0, or −1.
#[cfg_attr(target_arch = "wasm32", unsafe(no_mangle))]
pub extern "C" fn snapshot() -> i32 {
    answer(|simulation| simulation.snapshot().map(|number| number as u32))
}

/// Goes to the moment of that number, which stays kept. Returns 0, or −1.
#[cfg_attr(target_arch = "wasm32", unsafe(no_mangle))]
pub extern "C" fn restore(number: u32) -> i32 {
    answer(|simulation| simulation.restore(number as usize).map(|()| 0))
}

/// Drops the moment of that number and all later ones.
#[cfg_attr(target_arch = "wasm32", unsafe(no_mangle))]
pub extern "C" fn forget(number: u32) {
    answer(|simulation| {
        simulation.forget(number as usize);
        Ok(0)
    });
}
