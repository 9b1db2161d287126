//! What fails while the rest goes on: kept until the end, and then told together.

use anyhow::{Result, anyhow};

/// So many are kept word by word; who asks for a recording on a full disk again and again makes no more of them.
const MOST: usize = 8;

/// What has failed so far.
#[derive(Debug, Default)]
pub struct Failures {
    kept: Vec<anyhow::Error>,
    left_out: u64,
}

impl Failures {
    /// Takes note of a result; gives what there is of it.
    pub fn note<T>(&mut self, result: Result<T>) -> Option<T> {
        match result {
            Ok(value) => Some(value),
            Err(error) => {
                if self.kept.len() < MOST {
                    self.kept.push(error);
                } else {
                    self.left_out += 1;
                }
                None
            }
        }
    }

    /// Nothing has failed.
    ///
    /// # Errors
    /// Something has; the message tells of all of it.
    pub fn told(mut self) -> Result<()> {
        if self.kept.len() <= 1 {
            return self.kept.pop().map_or(Ok(()), Err);
        }
        let mut words: Vec<String> = self.kept.iter().map(|error| format!("{error:#}")).collect();
        if self.left_out > 0 {
            words.push(format!("{} more", self.left_out));
        }
        Err(anyhow!(words.join("; ")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_that_failed_is_told_and_what_is_too_much_is_counted() {
        let mut failures = Failures::default();
        assert_eq!(failures.note(Ok(7)), Some(7));
        assert!(failures.told().is_ok());
        let mut failures = Failures::default();
        for number in 1..=10 {
            let failed: Option<()> = failures.note(Err(anyhow!("file {number}")));
            assert_eq!(failed, None);
        }
        let told = failures.told().unwrap_err().to_string();
        assert!(told.starts_with("file 1; file 2; "), "{told}");
        assert!(told.ends_with("file 8; 2 more"), "{told}");
    }
}
