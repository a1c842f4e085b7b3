classdef Drone < handle
%DRONE A drone of the page's server, over its HTTP interface.
%   Make one with twodof.connect. Quantities are in SI units and radians.
%   Every method that commands waits until the drone confirms it, and ends in
%   the error twodof:refused with the reason otherwise. The server levels the
%   drone when no command has come for 3 s, and disarms it after 10 s: let
%   time pass with run, not with pause.

    properties (SetAccess = private)
        url = '';       % of the server
        number = 0;     % MAVLink system of the drone
    end
    properties
        timeout = 30;   % longest time of a request [s]
    end
    properties (Access = private)
        token = '';
        flying = false; % from arm to disarm: run keeps the right to command
    end

    methods
        function drone = Drone(url, token, number)
            drone.url = url;
            drone.token = token;
            if number == 0
                found = drone.ask('GET', '/drones');
                if isempty(found)
                    error('twodof:noDrone', '%s: no drone was heard. Start one: twodof up', url);
                elseif iscell(found)
                    found = found{1};
                end
                number = found(1).system;
            end
            drone.number = number;
        end

        % ---- commands

        function arm(drone)
            drone.command('POST', '/arm');
            drone.flying = true;
        end

        function disarm(drone)
            drone.flying = false;
            drone.command('POST', '/disarm');
        end

        function kill(drone)
            %KILL Stop the motors now. It holds until release.
            drone.flying = false;
            drone.command('POST', '/kill');
        end

        function release(drone)
            drone.command('POST', '/release');
        end

        function give_up(drone)
            %GIVE_UP Let another program or page command.
            drone.command('DELETE', '/lease');
        end

        function set_mode(drone, mode)
            %SET_MODE Enter manual, rate, attitude, position, hold or offboard.
            drone.command('POST', '/mode', struct('mode', mode));
        end

        function level_hold(drone)
            %LEVEL_HOLD Let the drone hold itself level.
            drone.set_mode('hold');
        end

        function reset(drone, varargin)
            %RESET Restart a virtual drone: reset('rings', true, 'x', 0, 'noise', 1, 'seed', 1).
            drone.command('POST', '/reset', struct(varargin{:}));
        end

        % ---- set-points, repeated by the server until the next one

        function set_moment(drone, M, varargin)
            %SET_MOMENT set_moment(M) or set_moment(M, thrust), -1 to 1 and 0 to 1.
            drone.setpoint('M', M, 'thrust', varargin{:});
        end

        function set_pitch_rate(drone, q, varargin)
            %SET_PITCH_RATE set_pitch_rate(q) or set_pitch_rate(q, thrust), q in rad/s.
            drone.setpoint('q', q, 'thrust', varargin{:});
        end

        function set_pitch(drone, theta, varargin)
            %SET_PITCH set_pitch(theta) or set_pitch(theta, thrust), theta in rad.
            drone.setpoint('theta', theta, 'thrust', varargin{:});
        end

        function set_velocity(drone, v, varargin)
            %SET_VELOCITY set_velocity(v) or set_velocity(v, acceleration), along the rail in m/s.
            drone.setpoint('v', v, 'acceleration', varargin{:});
        end

        function set_position(drone, x, varargin)
            %SET_POSITION set_position(x) or set_position(x, acceleration), along the rail in m.
            drone.setpoint('x', x, 'acceleration', varargin{:});
        end

        function stop_setpoints(drone)
            drone.command('DELETE', '/setpoint');
        end

        % ---- excitations

        function played = excite(drone, excitation, loop, thrust)
            %EXCITE Begin an excitation on board, added to the set-point of a loop.
            %   excite(struct('kind', 'doublet', 'amplitude', 0.03, 'period', 0.6), 'M')
            %   The kinds are impulse, doublet, 3-2-1-1, steps, sweep, prbs and
            %   multisine; the loops are theta, q, M, v and x.
            body = struct('excitation', excitation, 'loop', loop);
            if nargin > 3
                body.thrust = thrust;
            end
            played = drone.command('POST', '/excitation', body);
        end

        function stop_excitation(drone)
            drone.command('DELETE', '/excitation');
        end

        function name = fly(drone, experiment)
            %FLY Fly a ready-made experiment from arm to disarm, and return its log's name: fly('doublet').
            asked = struct('drone', drone.number, 'experiment', struct('name', experiment));
            job = drone.done(drone.ask('POST', '/identification/fly', asked));
            name = job.result.log;
        end

        % ---- state, telemetry, time

        function found = state(drone)
            %STATE State of the drone: armed, mode, failsafe, battery, ...
            found = drone.ask('GET', drone.path(''));
        end

        function run(drone, seconds)
            %RUN Let time pass, and keep the right to command.
            started = tic();
            while toc(started) < seconds
                if drone.flying
                    drone.command('POST', '/lease');
                end
                pause(max(0, min(1, seconds - toc(started))));
            end
        end

        function rows = telemetry(drone, columns, seconds)
            %TELEMETRY Samples at 250 Hz of the next seconds (at most 2), as columns.
            %   rows = telemetry({'estimate.theta', 'estimate.q'}, 0.5) has the
            %   fields time, estimate_theta and estimate_q.
            if drone.flying
                drone.command('POST', '/lease');
            end
            named = sprintf('column=%s&', columns{:});
            rows = drone.ask('GET', drone.path(sprintf('/telemetry?%sseconds=%g', named, seconds)));
        end

        % ---- parameters

        function values = parameters(drone)
            %PARAMETERS Values of all parameters by name.
            rows = drone.ask('GET', drone.path('/parameters'));
            values = cell2struct({rows.value}, {rows.name}, 2);
        end

        function set_parameters(drone, values)
            %SET_PARAMETERS Change several parameters together: set_parameters(struct('RATE_KP', 0.08)).
            drone.command('PATCH', '/parameters', values);
        end

        % ---- logs and models

        function names = logs(drone)
            %LOGS Names of the finished logs, the latest first. Waits for the end of a recording.
            now = drone.state();
            while ~isempty(now.recording)
                pause(0.2);
                now = drone.state();
            end
            found = drone.ask('GET', '/logs');
            rows = found.logs;
            names = {};
            for k = 1:numel(rows)
                if ~rows(k).recording
                    names{end + 1} = rows(k).name; %#ok<AGROW>
                end
            end
        end

        function found = log(drone, name)
            %LOG Log as a struct, with the channels of the drone's own logs; by default the latest.
            if nargin < 2
                name = drone.latest();
            end
            file = [tempname(), '.mat'];
            removed = onCleanup(@() delete(file)); %#ok<NASGU>
            drone.send('GET', [drone.place(name), '/file?form=mat'], '', file);
            found = load(file);
        end

        function model = identify(drone, name, varargin)
            %IDENTIFY Model from a log, by default from the latest: identify(name, 'structure', 'auto').
            %   model.estimates.mu has value, sigma and unit. Errors: twodof:refused.
            if nargin < 2
                name = drone.latest();
            end
            job = drone.done(drone.ask('POST', '/identification/fit', struct('log', name, varargin{:})));
            model = job.result.model;
        end
    end

    methods (Access = private)
        function answer = command(drone, method, what, varargin)
            answer = drone.ask(method, drone.path(what), varargin{:});
        end

        function job = done(drone, job)
            % Wait for the end of a job of the server.
            while strcmp(job.state, 'running')
                pause(0.2);
                job = drone.ask('GET', ['/jobs/', job.id]);
            end
            if ~strcmp(job.state, 'done')
                why = job.error;
                error('twodof:refused', '%s: %s (%s)', why.where, why.what, why.remedy);
            end
        end

        function setpoint(drone, loop, value, further, varargin)
            body = struct('loop', loop, 'value', value);
            if ~isempty(varargin)
                body.(further) = varargin{1};
            end
            drone.command('PUT', '/setpoint', body);
        end

        function found = path(drone, what)
            found = sprintf('/drones/%d%s', drone.number, what);
        end

        function found = place(~, name)
            found = ['/logs/', strrep(char(name), ' ', '%20')];
        end

        function name = latest(drone)
            names = drone.logs();
            if isempty(names)
                error('twodof:noLog', '%s: there is no log yet. Fly first: each flight is recorded.', drone.url);
            end
            name = names{1};
        end

        function answer = ask(drone, method, what, body)
            % Send a request, with a struct as JSON, and return the answer as a struct.
            text = '{}';
            if nargin > 3 && ~isempty(fieldnames(body))
                text = jsonencode(body);
            end
            answer = jsondecode(drone.send(method, what, text, ''));
        end

        function text = send(drone, method, what, body, file)
            % Send a request and return the text of its answer, or write that into `file`.
            given = {'Timeout', drone.timeout, 'ContentType', 'text'};
            if ~isempty(drone.token)
                given = [given, {'HeaderFields', {'Authorization', ['Bearer ', drone.token]}}];
            end
            text = '';
            octave = exist('OCTAVE_VERSION', 'builtin') ~= 0;
            try
                if strcmp(method, 'GET') && isempty(file)
                    text = webread([drone.url, '/api', what], weboptions(given{:}));
                elseif octave
                    text = drone.with_curl(method, what, body, file);
                elseif isempty(file)
                    options = weboptions(given{:}, 'MediaType', 'application/json', 'RequestMethod', lower(method));
                    text = webwrite([drone.url, '/api', what], body, options);
                else
                    websave(file, [drone.url, '/api', what], weboptions(given{:}));
                end
            catch reason
                if strcmp(reason.identifier, 'twodof:refused')
                    rethrow(reason);
                end
                error('twodof:http', '%s %s%s: %s', method, drone.url, what, reason.message);
            end
        end

        function text = with_curl(drone, method, what, body, file)
            % webwrite of Octave 7 sends forms only, and websave is missing. The token is in a file that only
            % this user reads, not on the command line.
            before = umask(77);
            config = tempname();
            stream = fopen(config, 'w');
            umask(before);
            removed = onCleanup(@() delete(config)); %#ok<NASGU>
            line = @(name, value) fprintf(stream, '%s = "%s"\n', name, strrep(strrep(value, '\', '\\'), '"', '\"'));
            line('url', [drone.url, '/api', what]);
            line('request', method);
            line('header', 'Content-Type: application/json');
            line('header', ['Authorization: Bearer ', drone.token]);
            if isempty(file)
                line('data', body);
            else
                line('output', file);
            end
            line('write-out', '\n%{http_code}');
            fprintf(stream, 'silent\nshow-error\nmax-time = %d\n', drone.timeout);
            fclose(stream);
            [failed, answer] = system(['curl --config ', config, ' 2>&1']);
            [code, at] = regexp(answer, '\d+$', 'match', 'start', 'once');
            text = answer(1:max(at - 2, 0));
            if failed
                error('twodof:http', '%s', strtrim(answer));
            elseif str2double(code) >= 400
                if ~isempty(file)
                    text = fileread(file);
                end
                told = jsondecode(text);
                error('twodof:refused', '%s: %s (%s)', told.where, told.what, told.remedy);
            end
        end
    end
end
