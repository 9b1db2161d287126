//! Errors that do not stop a run: collected and reported together at its end.

use anyhow::{Result, anyhow};

/// Errors kept in full; bounds repeated requests for a recording on a full disk.
const MAX_ERRORS: usize = 8;

#[derive(Debug, Default)]
pub struct DeferredErrors {
    errors: Vec<anyhow::Error>,
    omitted: u64,
}

impl DeferredErrors {
    /// Stores an error; returns the value of a success.
    pub fn record<T>(&mut self, result: Result<T>) -> Option<T> {
        match result {
            Ok(value) => Some(value),
            Err(error) => {
                if self.errors.len() < MAX_ERRORS {
                    self.errors.push(error);
                } else {
                    self.omitted += 1;
                }
                None
            }
        }
    }

    pub fn into_result(mut self) -> Result<()> {
        if self.errors.len() <= 1 {
            return self.errors.pop().map_or(Ok(()), Err);
        }
        let mut words: Vec<String> = self.errors.iter().map(|error| format!("{error:#}")).collect();
        if self.omitted > 0 {
            words.push(format!("{} more", self.omitted));
        }
        Err(anyhow!(words.join("; ")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_that_failed_is_told_and_what_is_too_much_is_counted() {
        let mut failures = DeferredErrors::default();
        assert_eq!(failures.record(Ok(7)), Some(7));
        assert!(failures.into_result().is_ok());
        let mut failures = DeferredErrors::default();
        for number in 1..=10 {
            let failed: Option<()> = failures.record(Err(anyhow!("file {number}")));
            assert_eq!(failed, None);
        }
        let message = failures.into_result().unwrap_err().to_string();
        assert!(message.starts_with("file 1; file 2; "), "{message}");
        assert!(message.ends_with("file 8; 2 more"), "{message}");
    }
}
