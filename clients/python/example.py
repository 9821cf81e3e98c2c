"""A first look with the Python client, in cells for a notebook: `example.py http://127.0.0.1:8080 SITE TELESCOPE`.

With users, put a token into the variable STARMESH_TOKEN (`starmesh user token` makes one).
"""

# %% where the web node is, and who asks
import os
import sys
import time
import uuid

from starmesh_client import AuthenticatedClient, Client
from starmesh_client.api.commands import give_command
from starmesh_client.api.network import network
from starmesh_client.api.safety import safety
from starmesh_client.api.series import series
from starmesh_client.models import CommandRequest, Problem

url, site, telescope = sys.argv[1:] or ["http://127.0.0.1:8080", "demo", "alpha"]
token = os.environ.get("STARMESH_TOKEN")
client = AuthenticatedClient(url, token=token) if token else Client(url)

# %% all telescopes; judge a value by its age and quality, not by its time
for each in network.sync(client=client).telescopes:
    print(f"{each.id}: {each.safety.state}, {each.posture}, {each.quality}, {each.age_s:.1f} s old")

# %% what the verdict of one telescope rests on
verdict = safety.sync(site, telescope, client=client)
if isinstance(verdict, Problem):
    sys.exit(f"{verdict.title}: {verdict.detail}")
for one in verdict.body.inputs:
    print(f"  {one.input_}: {one.value}, {'good' if one.good else 'not good'}")

# %% what the wind was
answer = series.sync(site, telescope, client=client, properties="observingconditions/weather/WindSpeed", points=20)
for row in answer.rows:
    print(f"{row.series.property_}: {len(row.series.points)} points, {len(row.series.gaps)} gaps")

# %% an order: the same key again is the same order, so a broken connection cannot close twice
key = str(uuid.uuid4())
order = CommandRequest(command="close", reason="visitors in the dome", operator="ana")
command = give_command.sync(site, telescope, client=client, body=order, idempotency_key=key, prefer="wait=60")
while not isinstance(command, Problem) and command.state in ("sent", "accepted"):
    time.sleep(1)
    command = give_command.sync(site, telescope, client=client, body=order, idempotency_key=key, prefer="wait=60")
print(command.detail if isinstance(command, Problem) else f"{command.state}: {command.detail}")
