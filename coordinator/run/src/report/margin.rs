//! A terminal whose last columns stay free of the progress bar.
//!
//! The bar is drawn over and over in its own line, and fills that line to its end. When somebody presses
//! Ctrl-C, the terminal itself writes `^C` where the cursor is: at the end of a full line, and so into the
//! next one. The bar would then be drawn there, and the old one stay above it as a copy. With room for a
//! few such marks the cursor stays in the bar's line.

use std::io;

use console::Term;
use indicatif::{ProgressDrawTarget, TermLike};

/// Columns that stay free: two marks of two characters.
const FREE: u16 = 4;

/// See the module.
#[derive(Debug)]
pub(super) struct Margin<T>(T);

/// Standard error, to draw a bar on.
pub(super) fn stderr() -> ProgressDrawTarget {
    ProgressDrawTarget::term_like(Box::new(Margin(Term::buffered_stderr())))
}

impl<T: TermLike> TermLike for Margin<T> {
    fn width(&self) -> u16 {
        self.0.width().saturating_sub(FREE).max(1)
    }

    fn height(&self) -> u16 {
        self.0.height()
    }

    fn move_cursor_up(&self, n: usize) -> io::Result<()> {
        self.0.move_cursor_up(n)
    }

    fn move_cursor_down(&self, n: usize) -> io::Result<()> {
        self.0.move_cursor_down(n)
    }

    fn move_cursor_right(&self, n: usize) -> io::Result<()> {
        self.0.move_cursor_right(n)
    }

    fn move_cursor_left(&self, n: usize) -> io::Result<()> {
        self.0.move_cursor_left(n)
    }

    fn write_line(&self, s: &str) -> io::Result<()> {
        self.0.write_line(s)
    }

    fn write_str(&self, s: &str) -> io::Result<()> {
        self.0.write_str(s)
    }

    fn clear_line(&self) -> io::Result<()> {
        self.0.clear_line()
    }

    fn flush(&self) -> io::Result<()> {
        self.0.flush()
    }
}

#[cfg(test)]
pub(super) mod tests {
    use std::sync::{Arc, Mutex};

    use indicatif::{ProgressBar, ProgressStyle};

    use super::*;

    /// What is on a screen: a character after the last column begins a new line.
    #[derive(Debug, Clone)]
    pub(in super::super) struct Screen(Arc<Mutex<Cells>>);

    /// What draws a bar on a screen, with a margin.
    pub(in super::super) fn on(screen: &Screen) -> ProgressDrawTarget {
        ProgressDrawTarget::term_like(Box::new(Margin(screen.clone())))
    }

    #[derive(Debug, Default)]
    struct Cells {
        width: usize,
        lines: Vec<Vec<char>>,
        row: usize,
        column: usize,
    }

    impl Cells {
        fn put(&mut self, c: char) {
            match c {
                '\n' => (self.row, self.column) = (self.row + 1, 0),
                '\r' => self.column = 0,
                c => {
                    if self.column == self.width {
                        (self.row, self.column) = (self.row + 1, 0);
                    }
                    self.lines.resize_with(self.lines.len().max(self.row + 1), Vec::new);
                    let line = &mut self.lines[self.row];
                    line.resize(line.len().max(self.column + 1), ' ');
                    line[self.column] = c;
                    self.column += 1;
                }
            }
        }
    }

    impl Screen {
        pub(in super::super) fn new(width: usize) -> Self {
            Self(Arc::new(Mutex::new(Cells { width, ..Cells::default() })))
        }

        /// What stands on it, without empty rows.
        pub(in super::super) fn rows(&self) -> Vec<String> {
            let cells = self.0.lock().expect("no panic");
            let rows = cells.lines.iter().map(|line| line.iter().collect::<String>());
            rows.map(|row| row.trim_end().to_owned()).filter(|row| !row.is_empty()).collect()
        }

        /// What the terminal itself writes, or a program past the bar.
        pub(in super::super) fn put(&self, text: &str) {
            let mut cells = self.0.lock().expect("no panic");
            let mut chars = text.chars();
            while let Some(c) = chars.next() {
                // A colour: `ESC [ … m`.
                if c == '\u{1b}' {
                    chars.by_ref().find(char::is_ascii_alphabetic);
                } else {
                    cells.put(c);
                }
            }
        }

        pub(in super::super) fn lines_with(&self, text: &str) -> usize {
            let cells = self.0.lock().expect("no panic");
            let lines = cells.lines.iter().map(|line| line.iter().collect::<String>());
            lines.filter(|line| line.contains(text)).count()
        }

        fn change(&self, act: impl FnOnce(&mut Cells)) {
            act(&mut self.0.lock().expect("no panic"));
        }
    }

    impl TermLike for Screen {
        fn width(&self) -> u16 {
            self.0.lock().expect("no panic").width as u16
        }

        fn move_cursor_up(&self, n: usize) -> io::Result<()> {
            self.change(|cells| cells.row = cells.row.saturating_sub(n));
            Ok(())
        }

        fn move_cursor_down(&self, n: usize) -> io::Result<()> {
            self.change(|cells| cells.row += n);
            Ok(())
        }

        fn move_cursor_right(&self, n: usize) -> io::Result<()> {
            self.change(|cells| cells.column = (cells.column + n).min(cells.width));
            Ok(())
        }

        fn move_cursor_left(&self, n: usize) -> io::Result<()> {
            self.change(|cells| cells.column = cells.column.saturating_sub(n));
            Ok(())
        }

        fn write_line(&self, s: &str) -> io::Result<()> {
            self.put(s);
            self.put("\n");
            Ok(())
        }

        fn write_str(&self, s: &str) -> io::Result<()> {
            self.put(s);
            Ok(())
        }

        fn clear_line(&self) -> io::Result<()> {
            self.change(|cells| {
                let row = cells.row;
                if let Some(line) = cells.lines.get_mut(row) {
                    line.clear();
                }
                cells.column = 0;
            });
            Ok(())
        }

        fn flush(&self) -> io::Result<()> {
            Ok(())
        }
    }

    /// Bars on a screen on which somebody has pressed Ctrl-C twice while one was shown.
    fn bars_after_ctrl_c(target: Box<dyn TermLike>, screen: &Screen) -> usize {
        let bar = ProgressBar::with_draw_target(Some(10), ProgressDrawTarget::term_like(target));
        bar.set_style(ProgressStyle::with_template("{pos} of {len}").expect("valid"));
        bar.set_position(3);
        bar.force_draw();
        screen.put("^C");
        bar.println("stopping");
        screen.put("^C");
        bar.println("stopping at once");
        bar.set_position(4);
        bar.force_draw();
        assert_eq!(screen.lines_with("stopping"), 2);
        let bars = screen.lines_with("of 10");
        bar.finish_and_clear();
        bars
    }

    #[test]
    fn ctrl_c_leaves_no_copy_of_the_bar() {
        let screen = Screen::new(40);
        assert_eq!(bars_after_ctrl_c(Box::new(Margin(screen.clone())), &screen), 1);
        // The same without a margin, so that this test can see what it looks for.
        let screen = Screen::new(40);
        assert!(bars_after_ctrl_c(Box::new(screen.clone()), &screen) > 1);
    }
}
