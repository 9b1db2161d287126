//! Empty: mcap lists `paste` among its dependencies but uses it in its own tests only, and `paste` is no longer maintained.
