"""One call without a name, as people call: hand.py SERVICE FIELDS. Fields and answer are JSON."""

import json
import sys

from caller import Caller

name, fields = sys.argv[1:]
done = Caller("hand", caller="").call(name, **json.loads(fields))
print(json.dumps({field: getattr(done, field) for field in ("success", "message", "lease") if hasattr(done, field)}))
