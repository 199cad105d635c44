//! What else the machine did while something was measured.

use serde::Serialize;

use crate::threads::Threads;

/// Processor time since the machine started, of which the kernel keeps books (in its own ticks).
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct ProcessorTimes {
    /// Somebody worked, guests of this machine included.
    busy: f64,
    /// The host gave the time to other machines.
    stolen: f64,
    /// Nobody worked.
    idle: f64,
    /// Of `busy`, this program and the children that it has waited for.
    own: f64,
}

impl ProcessorTimes {
    fn read() -> Self {
        let text = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
        Self::parse(&text("/proc/stat"), &text("/proc/self/stat"))
    }

    /// From `/proc/stat` and `/proc/self/stat`.
    fn parse(machine: &str, process: &str) -> Self {
        let numbers = |words: &str| -> Vec<f64> {
            words.split_whitespace().map(|word| word.parse().unwrap_or_default()).collect()
        };
        // user nice system idle iowait irq softirq steal
        let line = machine.lines().find_map(|line| line.strip_prefix("cpu ")).unwrap_or_default();
        let spent = numbers(line);
        let at = |index: usize| spent.get(index).copied().unwrap_or_default();
        // The program's name, which may hold anything, ends with the last bracket; utime, stime, cutime and cstime are the 14th to
        // 17th field of the line.
        let after_name = process.rsplit(')').next().unwrap_or_default();
        let own = numbers(after_name).iter().skip(11).take(4).sum();
        Self {
            busy: at(0) + at(1) + at(2) + at(5) + at(6),
            stolen: at(7),
            idle: at(3) + at(4),
            own,
        }
    }
}

/// Number of tasks that want a processor, over the last minute.
fn load_average() -> f64 {
    let text = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    text.split_whitespace().next().and_then(|word| word.parse().ok()).unwrap_or_default()
}

/// A time that is watched.
#[derive(Debug)]
pub(super) struct Watch {
    books: ProcessorTimes,
    load_average: f64,
}

impl Watch {
    /// From now on.
    pub(super) fn begin() -> Self {
        Self { books: ProcessorTimes::read(), load_average: load_average() }
    }

    /// What went on since then.
    pub(super) fn so_far(&self) -> Load {
        let (others_share, stolen_share) = shares(self.books, ProcessorTimes::read());
        Load {
            processors: Threads::available().count(),
            others_share,
            stolen_share,
            average: [self.load_average, load_average()],
        }
    }
}

/// Shares of all processors' time that other programs and other machines had.
fn shares(before: ProcessorTimes, after: ProcessorTimes) -> (f64, f64) {
    let [busy, stolen, idle, own] = [
        after.busy - before.busy,
        after.stolen - before.stolen,
        after.idle - before.idle,
        after.own - before.own,
    ];
    let all = (busy + stolen + idle).max(1.0);
    // Children count when they have ended, and ticks are rounded.
    (((busy - own) / all).clamp(0.0, 1.0), (stolen / all).clamp(0.0, 1.0))
}

/// What other programs did meanwhile.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Load {
    /// Processors that the measurement may use.
    processors: usize,
    /// Share of the machine's processor time that other programs had.
    others_share: f64,
    /// Share that the host gave to other machines.
    stolen_share: f64,
    /// Before and after: this program's own processes count, too.
    average: [f64; 2],
}

impl Load {
    /// For people.
    pub(super) fn sentence(&self) -> String {
        let [before, after] = self.average;
        let processors = output::counted(self.processors as u64, "processor");
        format!(
            "meanwhile other programs had {:.0} % and other machines {:.0} % of the time of {processors}, load average \
             {before:.1}, then {after:.1}",
            100.0 * self.others_share,
            100.0 * self.stolen_share
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn others_time_is_what_was_busy_and_not_ours() {
        // Name with blanks and a bracket; 14th to 17th field: 10, 20, 300, 40.
        let process = "7 (a) b) S 1 1 1 0 -1 4 1 1 1 1 10 20 300 40 20 0 1 0 5";
        let machine = "cpu  100 0 50 1000 7 3 2 20 0 0\ncpu0 1 1 1 1\n";
        let books = ProcessorTimes::parse(machine, process);
        assert_eq!(books, ProcessorTimes { busy: 155.0, stolen: 20.0, idle: 1007.0, own: 370.0 });
        // A thousand ticks: 400 of ours, 200 of others, 100 stolen.
        let later = ProcessorTimes { busy: 755.0, stolen: 120.0, idle: 1307.0, own: 770.0 };
        assert_eq!(shares(books, later), (0.2, 0.1));
        assert_eq!(shares(books, books), (0.0, 0.0));
    }

    #[test]
    fn the_kernel_keeps_books_of_this_machine() {
        let watch = Watch::begin();
        assert!(watch.books.idle > 0.0 && watch.books.busy >= watch.books.own, "{watch:?}");
        let load = watch.so_far();
        assert!(load.sentence().contains(" % of the time of "), "{}", load.sentence());
    }
}
