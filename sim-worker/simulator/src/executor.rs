//! Independent tasks on whatever threads the caller has.
//!
//! The simulator starts no thread itself: in a browser there are none. Who has threads implements
//! [`Executor`]; no result depends on it.

use std::sync::{Mutex, PoisonError};

/// Something that does independent tasks, perhaps several at once.
pub trait Executor: Sync {
    /// Calls `task` once with each of `0..n_tasks`, in any order and from any threads, and returns when all have ended.
    ///
    /// One that gives up leaves tasks out; what is made of the others is of no use then.
    fn run(&self, n_tasks: usize, task: &(dyn Fn(usize) + Sync));
}

/// One task after the other, on the caller's thread.
#[derive(Debug, Clone, Copy, Default)]
pub struct InOrder;

impl Executor for InOrder {
    fn run(&self, n_tasks: usize, task: &(dyn Fn(usize) + Sync)) {
        (0..n_tasks).for_each(task);
    }
}

/// Does `work` on every part; ends with the error of the first part, in their order, that has one.
pub(crate) fn for_each<T: Send, E: Send>(
    executor: &dyn Executor,
    parts: Vec<T>,
    work: impl Fn(T) -> Result<(), E> + Sync,
) -> Result<(), E> {
    let parts: Vec<_> = parts.into_iter().map(|part| Mutex::new(Some(part))).collect();
    let first_error = Mutex::new(None);
    executor.run(parts.len(), &|index| {
        let taken = parts[index].lock().unwrap_or_else(PoisonError::into_inner).take();
        let part = taken.expect("an executor does every task once");
        if let Err(error) = work(part) {
            let mut first = first_error.lock().unwrap_or_else(PoisonError::into_inner);
            if first.as_ref().is_none_or(|(before, _)| index < *before) {
                *first = Some((index, error));
            }
        }
    });
    match first_error.into_inner().unwrap_or_else(PoisonError::into_inner) {
        Some((_, error)) => Err(error),
        None => Ok(()),
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Every task on a thread of its own, the last one first.
    #[derive(Debug)]
    pub(crate) struct Apart;

    impl Executor for Apart {
        fn run(&self, n_tasks: usize, task: &(dyn Fn(usize) + Sync)) {
            std::thread::scope(|scope| {
                for index in (0..n_tasks).rev() {
                    scope.spawn(move || task(index));
                }
            });
        }
    }

    #[test]
    fn every_part_is_done_once_and_the_first_error_comes_back() {
        for executor in [&InOrder as &dyn Executor, &Apart] {
            for n in [0, 1, 7] {
                let mut done = vec![0; n];
                let parts: Vec<(usize, &mut i32)> = done.iter_mut().enumerate().collect();
                let count = |part: (usize, &mut i32)| -> Result<(), usize> {
                    *part.1 += 1;
                    Ok(())
                };
                assert_eq!(for_each(executor, parts, count), Ok(()));
                assert_eq!(done, vec![1; n], "{n} parts");
            }
            let odd = |part: usize| if part.is_multiple_of(2) { Ok(()) } else { Err(part) };
            assert_eq!(for_each(executor, vec![2, 4, 5, 7], odd), Err(5));
        }
    }
}
