// A stranger's path: start the program, open what it says, kidnap the robot, see it recover, stop, open the report. No flag, no manual: every
// step follows from what program and page show.

import assert from 'node:assert/strict';
import { readFile } from 'node:fs/promises';
import path from 'node:path';
import { after, before, test } from 'node:test';
import { pathToFileURL } from 'node:url';
import { Browser } from './support/browser.mjs';
import { waitForState } from './support/page.mjs';
import { Program, newFolder } from './support/station.mjs';
