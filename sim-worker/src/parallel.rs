//! Independent parts of a job on several threads.

/// Does `work` on every part, in as many threads; ends with the error of the first thread that has one.
///
/// Threads take consecutive parts, so which error is returned depends on their number, and nothing else does.
pub(crate) fn for_each<T: Send, E: Send>(
    mut parts: Vec<T>,
    threads: usize,
    work: impl Fn(&mut T) -> Result<(), E> + Sync,
) -> Result<(), E> {
    let per_thread = parts.len().div_ceil(threads.max(1)).max(1);
    let work = &work;
    std::thread::scope(|scope| {
        let handles: Vec<_> = parts
            .chunks_mut(per_thread)
            .map(|share| scope.spawn(move || share.iter_mut().try_for_each(work)))
            .collect();
        handles.into_iter().try_for_each(|handle| {
            handle.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_is_done_once_and_errors_come_back() {
        for (n, threads) in [(0, 1), (7, 0), (7, 1), (7, 3), (2, 5)] {
            let mut done = vec![0; n];
            let parts: Vec<(usize, &mut i32)> = done.iter_mut().enumerate().collect();
            let count = |part: &mut (usize, &mut i32)| -> Result<(), usize> {
                *part.1 += 1;
                Ok(())
            };
            assert_eq!(for_each(parts, threads, count), Ok(()));
            assert_eq!(done, vec![1; n], "{n} parts, {threads} threads");
        }
        let odd = |part: &mut usize| if part.is_multiple_of(2) { Ok(()) } else { Err(*part) };
        assert_eq!(for_each(vec![2, 4, 5, 7], 2, odd), Err(5));
    }
}
