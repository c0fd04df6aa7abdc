# slurm_cluster.sh - a Slurm cluster of one controller and four nodes on this machine, for tests.
# Needs $work, a folder. start_cluster starts it, stop_cluster stops it. Runs as any user.

cluster=$work/cluster

write_conf()
{
    host=$(hostname -s) user=$(id -un)
    cat >"$cluster/slurm.conf" <<CONF
ClusterName=bisque
SlurmctldHost=$host(127.0.0.1)
SlurmUser=$user
SlurmdUser=$user
SlurmctldPort=17002
SlurmctldPidFile=$cluster/ctld.pid
SlurmdPidFile=$cluster/%n.pid
StateSaveLocation=$cluster/state
SlurmdSpoolDir=$cluster/spool-%n
SlurmctldLogFile=$cluster/ctld.log
SlurmdLogFile=$cluster/%n.log
AuthType=auth/none
CredType=cred/none
AuthInfo=cred_expire=5
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerParameters=sched_interval=2,bf_interval=2,batch_sched_delay=0
SwitchType=switch/none
MpiDefault=none
ReturnToService=2
SlurmdTimeout=12
MinJobAge=600
NodeName=n[1-4] NodeHostname=$host NodeAddr=127.0.0.1 Port=[17011-17014] CPUs=1 RealMemory=2000 State=UNKNOWN
PartitionName=main Nodes=ALL Default=YES MaxTime=INFINITE State=UP
CONF
}

# wait_until SECONDS COMMAND...: waits for the command to succeed; fails after that time.
wait_until()
{
    end=$(($(date +%s) + $1))
    shift
    until eval "$*"; do
        [ "$(date +%s)" -lt "$end" ] || return 1
        sleep 0.2
    done
}

start_node()
{
    slurmd -N "$1" -f "$SLURM_CONF" || return 1
}

start_cluster()
{
    mkdir -p "$cluster/state" && write_conf || return 1
    export SLURM_CONF="$cluster/slurm.conf"
    slurmctld -f "$SLURM_CONF" || return 1
    for node in n1 n2 n3 n4; do
        start_node $node || return 1
    done
    wait_until 600 '[ "$(sinfo -h -t idle -o %D 2>/dev/null)" = 4 ]'
}

# steps_of NODE: the processes of jobs on a node, by their parent's name.
steps_of()
{
    for pid in $(pgrep -x slurmstepd); do
        tr '\0' '\n' 2>/dev/null <"/proc/$pid/environ" | grep -qx "SLURMD_NODENAME=$1" && echo "$pid"
        grep -aq "$cluster/spool-$1" "/proc/$pid/maps" 2>/dev/null && echo "$pid"
        ls -l "/proc/$pid/fd" 2>/dev/null | grep -q "$cluster/$1.log" && echo "$pid"
    done | sort -u
}

# children PID: the process and all that it started.
children()
{
    echo "$1"
    for child in $(pgrep -P "$1"); do
        children "$child"
    done
}

# lose_node NODE: ends a node and all that runs on it, as when its machine loses power.
lose_node()
{
    victims=$(cat "$cluster/$1.pid")
    for step in $(steps_of "$1"); do
        victims="$victims $(children "$step")"
    done
    kill -KILL $victims
}

stop_cluster()
{
    [ -z "${SLURM_CONF-}" ] || scancel --user="$(id -un)" 2>/dev/null
    for file in "$cluster"/n?.pid "$cluster/ctld.pid"; do
        [ ! -s "$file" ] || kill "$(cat "$file")" 2>/dev/null
    done
}
